"""What a locator keeps of images."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from boxes import box_picture
from worlds import K as DATABASE_K
from worlds import known_model, render_views

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.options import Second
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.localization import locate
from dgc_pose.localization.location import Location
from dgc_pose.matchers import load_matcher
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.model import Model
from dgc_pose.pose import solve_pair


@pytest.mark.parametrize(("K", "source"), [("auto", "lines"), ("900,900,480,360", "given")])
def test_the_lines_of_a_query_tell_its_focal_length(tmp_path, monkeypatch, K, source) -> None:
    """Which no K states."""
    model = known_model(tmp_path, render_views(2, step=0.5))
    searched: list[Camera] = []

    def search(model: Model, camera: Camera, *others: Any, **options: Any) -> None:
        searched.append(camera)
        raise InputError("searched")

    monkeypatch.setattr(locate, "LocationSearch", search)
    with pytest.raises(InputError, match="searched"):
        locate.Locator(model, load_matcher()).locate(box_picture(1.2), K)
    (camera,) = searched
    assert camera.focal_source == source
    assert camera.focal == pytest.approx(900 if source == "given" else 1.2 * 960, rel=0.1)


def test_one_bad_image_among_many_is_told(tmp_path: Path) -> None:
    """Queries, and images of the model. Features go with their images: neither those of queries
    nor those of images that left the memory are kept."""
    photo, *views = render_views(4, step=0.5)
    model = known_model(tmp_path / "images", views)
    cut = tmp_path / "images" / "view0.png"
    cut.write_bytes(cut.read_bytes()[:-9000])
    options = EstimationOptions(effort="fast", runs=2, iterations=200)
    cache = ImageCache()
    locator = locate.Locator(model, load_matcher(cache=cache), options)
    cache.limit_bytes = 1
    bad = write_bad_pictures(tmp_path)
    queries = [photo.pixels, *bad, photo.pixels[:80], photo.pixels]
    first, *others, last = locator.locate_all(queries, DATABASE_K)
    assert first.success and last.success
    kept = {image.name for image in cache._kept}
    assert cache.made > 8 and len(kept) <= 1 and "query" not in kept
    assert {image.name for image in first.database_images} == {"view1.png", "view2.png"}
    assert [*locator.bad] == ["view0.png"] and str(cut) in locator.bad["view0.png"]
    assert {location.status for location in others} == {"bad_input"}
    for location, reason in zip(others, [*BAD_PICTURES.values(), "outside"], strict=True):
        assert reason in location.reason
    for path in bad:
        with pytest.raises(ImageError, match=re.escape(BAD_PICTURES[path.name])):
            locator.locate(path, DATABASE_K)
    view1, view2 = (tmp_path / "images" / name for name in ("view1.png", "view2.png"))
    view2.write_bytes(b"")
    (alone,) = locate.Locator(model, load_matcher(), options).locate_all([view1])
    assert alone.status == "nowhere"
    assert alone.reason == "1 of 3 images of the model can be used, and besides the query none"
    view1.write_bytes(b"")
    empty = locate.Locator(model, load_matcher(), options)
    for _ in range(2):
        with pytest.raises(ImageError, match=r"^none of the 3 images of the .*view0\.png"):
            [*empty.locate_all([photo.pixels])]


def test_an_error_in_the_middle_of_a_location_is_raised(tmp_path, monkeypatch) -> None:
    """It is not one of the query."""
    photo, *views = render_views(3, step=0.5)
    model = known_model(tmp_path, views)

    def fails(*arguments: Any) -> Any:
        raise InputError("not of the query")

    monkeypatch.setattr(locate, "solve_pair", fails)
    with pytest.raises(InputError, match="not of the query"):
        [*locate.Locator(model, load_matcher()).locate_all([photo.pixels], DATABASE_K)]


def test_a_wrong_K_of_the_query_gives_way_and_is_told(tmp_path, monkeypatch) -> None:
    """After two database images that contradict it."""
    views = render_views(5, step=0.5)
    photo = views.pop(2)
    model = known_model(tmp_path, views)
    cameras: list[Camera] = []

    def solved(image1: Any, image2: Any, pair: tuple[Camera, Camera], *others: Any) -> Any:
        cameras.append(pair[1])
        return solve_pair(image1, image2, pair, *others)

    monkeypatch.setattr(locate, "solve_pair", solved)
    options = EstimationOptions(effort="fast", runs=2, iterations=200)
    doubled = np.diag([2.0, 2.0, 1.0]) @ DATABASE_K
    doubled[:2, 2] = DATABASE_K[:2, 2]
    location = locate.Locator(model, load_matcher(), options).locate(photo.pixels, doubled)
    assert location.success and location.R is not None and location.centre is not None
    assert rotation_error_deg(location.R, photo.R) < 1
    assert np.linalg.norm(location.centre - photo.centre) < 0.1
    assert location.camera is not None
    assert location.camera.focal == pytest.approx(225, rel=0.05)
    (warning,) = location.warnings
    assert warning.startswith("query: the matches agree with f = ")
    assert warning.endswith(", and K states 452; the location is without this K")
    assert [camera.focal_source for camera in cameras[:3]] == ["given", "given", "size"]
    assert len(cameras) == 2 + len(location.database_images)


@pytest.mark.parametrize(
    ("second", "is_there", "statuses", "searched"),
    [
        ("auto", True, ["nowhere", "located"], ["none", "auto"]),
        ("auto", True, ["located"], ["none"]),
        ("auto", False, ["nowhere"], ["none"]),
        ("none", True, ["nowhere"], ["none"]),
    ],
)
def test_a_query_that_is_not_placed_is_searched_again_with_the_second_matcher(
    tmp_path, monkeypatch, second, is_there, statuses, searched
) -> None:
    done: list[Second] = []

    def search(self: Any, image: Image, camera: Camera, names: Any, *rest: Any, **_: Any) -> Any:
        done.append(rest[0].second)
        return Location(statuses[len(done) - 1], "", ())

    monkeypatch.setattr(locate.Locator, "_searched", search)
    query, *views = render_views(3, step=0.5)
    matcher = load_matcher()
    monkeypatch.setitem(vars(matcher), "second_matcher", matcher if is_there else None)
    options = EstimationOptions(second=second)
    locator = locate.Locator(known_model(tmp_path, views), matcher, options)
    assert locator.locate(query.pixels, DATABASE_K).status == statuses[-1]
    assert done == searched
