"""The dense map of images of any size, by the frozen network."""

from __future__ import annotations

from functools import partial

import numpy as np

from dgc_pose.geometry.pixels import cell_centres, rescale, within
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.image import Image
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.correspondence_map import WEAK, CorrespondenceMap
from dgc_pose.matching.view import View
from dgc_pose.matching.view_search import search_views
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.runtime.engine import DecodedMap, Engine, MapFeatures


def dense_map(
    engine: Engine,
    image1: Image,
    image2: Image,
    cache: ImageCache,
    *,
    cells: int = INPUT_SIZE,
    search: bool = True,
) -> CorrespondenceMap:
    """The map of a pair; image 1 is the network's source, image 2 its target.

    cache: of the encoder's features, by image and view. cells: a side, for a squared image. search:
    whether other rotations of image 2 and other scales are searched if the mean matchability is
    below `WEAK`, as the network is trained on upright photographs of similar scale.
    """
    images = image1, image2
    views = View.whole(image1.size), View.whole(image2.size)

    def decode(views: tuple[View, View]) -> DecodedMap:
        source, target = map_features(engine, cache, *zip(images, views, strict=True))
        return engine.decode(source, target, cells)

    decoded = decode(views)
    mean = decoded.matchability.mean()
    if search and mean < WEAK and (likely := search_views(engine, *images, cache)):
        again = decode(likely)
        inside = likely[1].inside(image2.size, again.matchability.shape[::-1])
        if again.matchability[inside].mean() > mean:
            views, decoded = likely, again
    return _map_of_views(engine, images, views, decoded, cells)


def map_features(
    engine: Engine, cache: ImageCache, *views: tuple[Image, View]
) -> list[MapFeatures]:
    """The encoder's features of views of images."""

    def encode(image: Image, view: View) -> MapFeatures:
        return engine.encode(view.cut(image.pixels))

    wanted = [(key, partial(encode, *key)) for key in views]
    return cache.get_all(wanted, in_turn=not engine.concurrent)


def _map_of_views(
    engine: Engine,
    images: tuple[Image, Image],
    views: tuple[View, View],
    decoded: DecodedMap,
    finest: int,
) -> CorrespondenceMap:
    """The map over image 2 as it is, from a map between views; with matchability 0 where the view
    of image 2 shows nothing."""
    size2, (view1, view2) = images[1].size, views
    points, matchability = decoded.points, decoded.matchability
    cells = matchability.shape[::-1]
    grid = cell_centres(cells, size2)
    if view2 != View.whole(size2):
        columns, rows = (side * finest // INPUT_SIZE for side in engine.config.input_size(size2))
        grid = cell_centres((columns, rows), size2)
        in_view = view2.to_view(grid)
        at = rescale(in_view, view2.size, cells)
        points, matchability = bilinear(points, at), bilinear(matchability, at)
        matchability = np.where(within(in_view, view2.size), matchability, np.float32(0))
    points1 = view1.to_image(rescale(points, decoded.size, view1.size))
    return CorrespondenceMap(
        map=points1.astype(np.float32),
        grid=grid.astype(np.float32),
        matchability=np.ascontiguousarray(matchability),
        size1=images[0].size,
        size2=size2,
    ).masked(*images)
