"""What a rig is estimated from, and what is refused before anything is written."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import contents
from worlds import SIZE, K, known_model, render_views, write_views

from dgc_pose.batch.source import Source
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.rigs.inputs import (
    PICTURES,
    FixedCameras,
    Photographs,
    fixed_cameras,
    images_in_model,
    metres_of,
    require_new_rig,
    walk_photographs,
)

UP_TO_SCALE = ReconstructionOptions()


@pytest.fixture(scope="module")
def cameras(tmp_path_factory: pytest.TempPathFactory) -> FixedCameras:
    """A picture, frames of which half are white below, and a broken picture, as three cameras."""
    folder = tmp_path_factory.mktemp("rig")
    first, second = render_views(2)
    (folder / "frames" / "desk").mkdir(parents=True)
    cv2.imwrite(str(folder / "frames" / "door.png"), first.pixels)
    for number in range(4):
        pixels = second.pixels.copy()
        pixels[-40:] |= 255 * (number % 2)
        cv2.imwrite(str(folder / "frames" / "desk" / f"{number}.png"), pixels)
    (folder / "frames" / "lamp.jpg").write_bytes(b"")
    return fixed_cameras(folder / "frames", folder / "out", None, {"door": K}, UP_TO_SCALE)


def test_the_cameras_have_pictures_and_masks_in_folders_of_their_own(
    cameras: FixedCameras,
) -> None:
    assert {name: path.name for name, path in cameras.pictures.items()} == {
        "desk": "desk.png",
        "door": "door.png",
    }
    (folder,) = {path.parent for path in cameras.pictures.values()}
    assert folder.as_posix().endswith(f"out/{PICTURES}") and folder != cameras.masks
    assert {path.name for path in folder.iterdir()} == {"desk.png", "door.png"}
    assert [path.name for path in cameras.masks.iterdir()] == ["desk.png.png"]
    mask = cv2.imread(str(cameras.masks / "desk.png.png"), cv2.IMREAD_GRAYSCALE)
    assert not mask[-35:].any() and mask[:130].all()
    np.testing.assert_array_equal(cameras.exact["door"].K, K)
    assert cameras.exact["door"].size == SIZE and {*cameras.exact} == {"door"}
    assert {*cameras.unusable} == {"lamp"} and cameras.unusable["lamp"].endswith("lamp.jpg: empty")


def test_images_and_distances_have_the_names_of_the_model(
    cameras: FixedCameras, tmp_path: Path
) -> None:
    """A photograph may have the name of a camera's picture."""
    model = known_model(tmp_path, render_views(2))
    walk = Photographs(Source(tmp_path, ("door.png",), None, {}), None)
    door, desk = cameras.pictures["door"], cameras.pictures["desk"]
    own = {"desk.png": desk, "door.png": door}
    assert images_in_model(cameras, None) == own
    assert images_in_model(cameras, walk) == own | {"walk/door.png": tmp_path / "door.png"}
    views = {f"walk/view{n}.png": tmp_path / f"view{n}.png" for n in range(2)}
    assert images_in_model(cameras, model) == own | views
    known, frame = metres_of(cameras, own, ReconstructionOptions(scale="door,desk,2.5"))
    assert (known, frame) == ({"door.png": 2.5, "desk.png": 2.5}, "the model's own")


@pytest.mark.parametrize(
    ("names", "known", "scale", "why"),
    [
        ("a b", {"c": K}, None, "^K is of c, and the cameras are a, b$"),
        ("a b", {"a": "1,2"}, None, "^K of a: '1,2' is neither"),
        ("a b", {"a": K + np.eye(3, k=1)}, None, "^a: .*skew"),
        ("a", {}, None, "1 cameras found, and a rig has two$"),
        ("a b", {}, "a,c,2", r"^scale must be two of the 2 images \(such as a\) and metres"),
        ("a a.b", {}, "a,b,2", r"^scale must be two of the 2 images"),
    ],
)
def test_nothing_is_written_for_what_is_refused(
    tmp_path: Path, names: str, known: dict[str, object], scale: str | None, why: str
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    listed = names.split()
    for name, view in zip(listed, render_views(2)[: len(listed)], strict=True):
        (frames / write_views(frames, [view])[0]).rename(frames / f"{name}.png")
    before = contents(tmp_path)
    with pytest.raises(InputError, match=why):
        fixed_cameras(frames, tmp_path / "out", None, known, ReconstructionOptions(scale=scale))
    assert contents(tmp_path) == before


def test_inputs_do_not_overlap_what_is_written(tmp_path: Path) -> None:
    """Nor is a rig replaced without being asked."""
    out = tmp_path / "out"
    for path in (out, out / "rig_pictures", out / "rig_pictures" / "cameras"):
        with pytest.raises(InputError, match=f"^frames {path} overlaps the results in {out}$"):
            require_new_rig(path, out, None, resume=False)
        with pytest.raises(InputError, match=f"^walk {path} overlaps the results in {out}$"):
            require_new_rig(tmp_path / "frames", out, str(path), resume=False)
    require_new_rig(tmp_path / "frames", out, tmp_path / "walk", resume=False)
    require_new_rig(out / "frames", out, out / "walk", resume=False)
    out.mkdir()
    (out / "rig.json").write_text("{}")
    with pytest.raises(InputError, match=r"rig\.json exists already: resume continues"):
        require_new_rig(tmp_path / "frames", out, None, resume=False)
    require_new_rig(tmp_path / "frames", out, None, resume=True)


def test_a_walk_of_one_picture_is_refused(tmp_path: Path) -> None:
    write_views(tmp_path / "walk", render_views(1))
    with pytest.raises(InputError, match="walk: one image, and a pair needs two$"):
        walk_photographs(tmp_path / "walk", "auto", tmp_path / "out")
    assert walk_photographs(None, "auto", tmp_path / "out") is None
