"""The authors' lists: maps and views against loops in double precision."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import map_coordinates

from dgc_pose.errors import ImageError, InputError
from dgc_pose.training.synthesis.render.procedural import procedural_textures
from dgc_pose.training.synthesis.warp_lists import WarpRow, list_pairs, read_warps

_HEADER = "fname,aff/tps/homo," + ",".join(f"t{k}" for k in range(1, 19))
_AFFINE = (0.9, 0.12, 0.1, -0.2, 1.1, -0.15)
_HOMOGRAPHY = (0.95, 0.08, 12.0, -0.05, 1.07, -9.0, 1.2e-4, -0.8e-4, 1.0)
_BASE = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]


def _padded(values: tuple[float, ...]) -> tuple[float, ...]:
    return values + (0.0,) * (18 - len(values))


def _spline_values() -> tuple[float, ...]:
    targets = np.array(_BASE) + 0.2 * np.random.default_rng(0).standard_normal((9, 2))
    return tuple(targets.T.reshape(-1).tolist())


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of the very sizes that views are cut from, so that nothing is resized."""
    folder = tmp_path_factory.mktemp("images") / "deep"
    folder.mkdir()
    texture = procedural_textures(1, 768, seed=0)[0].permute(1, 2, 0).numpy()
    texture = cv2.GaussianBlur((255 * texture).round().astype(np.uint8), (0, 0), 3)
    cv2.imwrite(str(folder / "small.png"), texture[:480, :640, ::-1])
    cv2.imwrite(str(folder / "large.png"), texture[:576, :768, ::-1])
    return folder.parent


def _write(path: Path, *rows: str, header: str = _HEADER) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def _row(name: str, kind: int, values: tuple[float, ...]) -> str:
    return f"{name},{kind}," + ",".join(map(repr, _padded(values)))


def test_read_gives_the_rows_in_order(tmp_path: Path) -> None:
    spline = _spline_values()
    path = _write(
        tmp_path / "list.csv",
        _row("a.jpg", 0, _AFFINE),
        _row("b/c.jpg", 1, spline),
        _row("a.jpg", 2, _HOMOGRAPHY),
    )
    rows = read_warps(path)
    assert [row.kind for row in rows] == ["affine", "tps", "homography"]
    assert [row.file for row in rows] == ["a.jpg", "b/c.jpg", "a.jpg"]
    assert rows[0].parameters == _padded(_AFFINE) and rows[1].parameters == spline


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.jpg,0,1,2", "expected 20 fields, found 4"),
        (_row("a.jpg", 3, _AFFINE), "kind must be 0, 1 or 2"),
        (_row("a.jpg", 0, _AFFINE).replace("0.12", "x"), "could not convert"),
        (_row("a.jpg", 0, (float("nan"),)), "finite"),
        (_row("", 0, _AFFINE), "file name"),
        (_row("a.jpg", 2, (1.0, 0.0, 0.0, 2.0)), "cannot be inverted"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = _write(tmp_path / "list.csv", _row("a.jpg", 0, _AFFINE), line)
    with pytest.raises(InputError, match=message) as error:
        read_warps(path)
    assert str(error.value).startswith(f"{path}:3:") and "\n" not in str(error.value)


def test_a_file_that_is_no_list_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="list.csv:1: expected the columns"):
        read_warps(_write(tmp_path / "list.csv", "a", header="obj,im1"))
    with pytest.raises(InputError, match="no rows"):
        read_warps(_write(tmp_path / "list.csv"))
    with pytest.raises(ImageError, match="none.jpg"):
        list_pairs([WarpRow("none.jpg", "affine", _padded(_AFFINE))], tmp_path)


def _normalised(pixel: float) -> float:
    return 2 * pixel / 239 - 1


def _bilinear(image: np.ndarray, x: float, y: float, mode: str) -> list[float]:
    """A colour; mode: what is beyond the edges, as SciPy names it."""
    return [map_coordinates(image[..., k], [[y], [x]], order=1, mode=mode)[0] for k in range(3)]


_PLACES = [(0, 0), (239, 0), (17, 200), (120, 119), (239, 239), (3, 121), (200, 64)]


@pytest.mark.parametrize("kind", ["affine", "tps"])
def test_affine_and_spline_rows_are_as_the_authors_cut_them(root: Path, kind: str) -> None:
    values = _padded(_AFFINE) if kind == "affine" else _spline_values()
    pairs = list_pairs([WarpRow("deep/small.png", kind, values)], root)  # type: ignore[arg-type]
    image = cv2.imread(str(root / "deep" / "small.png"))[..., ::-1] / 255.0
    spline = None
    if kind == "tps":
        targets = np.reshape(values, (2, 9)).T
        spline = RBFInterpolator(np.array(_BASE, float), targets, kernel="thin_plate_spline")

    def view(x: float, y: float) -> list[float]:
        """The photograph mirrored by half its size on every side, at 9/16 of half of that."""
        column = (x * 0.5 * 9 / 16 + 1) / 2 * (2 * 640 - 1) - 320
        row = (y * 0.5 * 9 / 16 + 1) / 2 * (2 * 480 - 1) - 240
        return _bilinear(image, column, row, mode="reflect")

    seen = 0
    for column, row in _PLACES:
        x, y = _normalised(column), _normalised(row)
        if spline is None:
            a, b, c, d, e, f = values[:6]
            place = (a * x + b * y + c, d * x + e * y + f)
        else:
            place = tuple(spline([(x, y)])[0])
        expected = [(v + 1) * 239 / 2 for v in place]
        found = pairs.map[0, row, column].double().numpy()
        np.testing.assert_allclose(found, expected, atol=2e-3)
        inside = max(abs(place[0]), abs(place[1])) <= 1
        assert bool(pairs.valid[0, row, column]) == inside
        seen += inside
        for pixels, where in ((pairs.image1, (x, y)), (pairs.image2, place)):
            np.testing.assert_allclose(pixels[0, :, row, column], view(*where), atol=2e-3)
    assert 0 < seen < len(_PLACES)


def test_homography_rows_are_as_the_authors_cut_them(root: Path) -> None:
    row = WarpRow("deep/large.png", "homography", _padded(_HOMOGRAPHY))
    pairs = list_pairs([row], root)
    image = cv2.imread(str(root / "deep" / "large.png"))[..., ::-1] / 255.0
    inverse = np.linalg.inv(np.reshape(_HOMOGRAPHY, (3, 3)))
    for column, line in _PLACES:
        x, y, w = inverse @ (column + 264, line + 168, 1)
        place = (x / w, y / w)
        found = pairs.map[0, line, column].double().numpy()
        np.testing.assert_allclose(found, (place[0] - 264, place[1] - 168), atol=2e-3)
        valid = all(0 <= value <= 239 for value in (place[0] - 264, place[1] - 168))
        assert bool(pairs.valid[0, line, column]) == valid
        first = image[line + 168, column + 264]
        np.testing.assert_allclose(pairs.image1[0, :, line, column], first, atol=1e-3)
        second = _bilinear(image, *place, mode="grid-constant")
        np.testing.assert_allclose(pairs.image2[0, :, line, column], second, atol=2e-3)
    # The same view as OpenCV's, which rounds points to 1/32 pixel.
    warped = cv2.warpPerspective(image, np.reshape(_HOMOGRAPHY, (3, 3)), (768, 576))
    crop = warped[168:408, 264:504].transpose(2, 0, 1)
    assert np.abs(pairs.image2[0].numpy() - crop).mean() < 2e-3
