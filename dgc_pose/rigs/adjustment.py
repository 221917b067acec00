"""Located cameras in their final model, and in metres: one bundle adjustment of the cameras with
the walk, or with each other."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera, colmap_camera, image_size, matrix_camera
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.cameras.prior import LENS_STD, MOUNTED_STD, nearest_part
from dgc_pose.colmap.database import to_stored
from dgc_pose.estimation.intrinsics_prior import (
    SIZE,
    between,
    have_same_lens,
    parameter_stds,
    with_parameters,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.pixels import turn_points
from dgc_pose.geometry.rotation import camera_centres
from dgc_pose.localization.location import Location
from dgc_pose.model import HALF_PIXEL, Model
from dgc_pose.rigs.bundle import Bundle, BundleCamera, Matched, Observed, adjusted_bundle
from dgc_pose.system.colmap_library import pycolmap

# Largest reprojection error of a point in the adjustment: in pixels, or times the median error, as
# the location may be off.
_MAX_ERROR_PX = 2.0
_WIDE = 3.0
# Expected errors over those of the adjustment; and over these for an exact K, which cannot make up
# for errors of the walk's camera: docs/experiments.md.
_ERROR_FACTOR = 2.2
_EXACT_FACTOR = 1.2
WALK = "walk/"  # prefix of the names of the walk's images


def extended(
    model: Model, located: Mapping[str, Location], pictures: Mapping[str, Path]
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """COLMAP's form of the model with the located cameras, and their image ids by camera name.

    The other images get the prefix `walk/`; those without a file, which `model` lacks, lose their
    pose. pictures: of the cameras, by name.
    """
    views = {
        pictures[name]: (location.camera, location.cam_from_world)
        for name, location in located.items()
    }
    whole = model.extended(
        {p: (c, pose) for p, (c, pose) in views.items() if c and pose is not None}
    )
    ids = sorted(whole.images)
    new = dict(zip(located, ids[len(ids) - len(located) :], strict=True))
    names = {model.colmap_names.get(name, name): name for name in model.poses}
    for image in [whole.images[number] for number in ids if number not in new.values()]:
        name = names.get(image.name)
        if name is not None:
            image.name = WALK + name
        elif image.has_pose:
            whole.deregister_frame(image.frame_id)
    return whole, new


def adjusted(
    model: Model,
    located: Mapping[str, Location],
    pictures: Mapping[str, Path],
    stated: Mapping[str, Camera],
) -> tuple[pycolmap.Reconstruction, dict[str, int], dict[str, Location]]:
    """Bundle adjustment of the model of `extended`: the model, the image ids, and the located
    cameras with new poses, cameras, errors and probabilities. Exact cameras keep their K.

    model: with COLMAP's form. pictures: the upright pictures of the cameras, by name. stated: the
    cameras of the walk's upright images as stated or assumed, by name.
    """
    whole, numbers = extended(model, located, pictures)
    start = _Start(model, whole, numbers.values())
    walk = [number for number in start.index if number not in numbers.values()]
    observed = start.known_observed(walk)
    for name, location in located.items():
        observed += start.observed(numbers[name], location)
    placed = _adjusted(start, located, numbers, observed, stated, walk)
    return whole, numbers, placed


def adjusted_own(
    model: Model,
    located: Mapping[str, Location],
    pictures: Mapping[str, Path],
    stated: Mapping[str, Camera],
) -> tuple[pycolmap.Reconstruction, dict[str, int], dict[str, Location]]:
    """As `adjusted`, for a model of the cameras' own pictures, all of which determine the frame."""
    assert model.colmap is not None  # of `upright_model`
    by_file = {image.name: image.image_id for image in model.colmap.images.values()}
    numbers = {name: by_file[pictures[name].name] for name in located}
    start = _Start(model, model.colmap)
    every = [*start.index]
    placed = _adjusted(start, located, numbers, start.known_observed(every), stated, every)
    return model.colmap, numbers, placed


def _adjusted(
    start: _Start,
    located: Mapping[str, Location],
    numbers: Mapping[str, int],
    observed: Sequence[Observed],
    stated: Mapping[str, Camera],
    fixing: Sequence[int],
) -> dict[str, Location]:
    """Adjust the model of `start`, and return the located cameras.

    numbers: their image ids. stated: cameras of the model's upright images as stated, by name.
    fixing: ids of the images that determine the frame.
    """
    priors = start.stated(stated)
    matched = dict[frozenset[int], Matched]()  # once, for two located cameras
    for name, location in located.items():
        for part in start.matched(numbers[name], location):
            matched.setdefault(frozenset(part.images), part)
        if location.stated is not None:
            priors[start.camera_of[start.index[numbers[name]]]] = location.stated
    bundle = Bundle(
        [bundle_camera(camera, priors.get(n, camera)) for n, camera in enumerate(start.cameras)],
        start.camera_of,
        start.poses[:, :, :3],
        camera_centres(start.poses),
        start.points,
        observed,
        [*matched.values()],
        [start.index[number] for number in fixing],
    )
    fit = adjusted_bundle(bundle)
    covariance = _ERROR_FACTOR**2 * fit.covariance()
    cameras = start.final_cameras(fit.bundle)
    added = {start.index[number] for number in {*numbers.values()} - {*fixing}}
    start.write(fit.bundle, cameras, added)
    placed = {}
    for name, location in located.items():
        number = start.index[numbers[name]]
        changed = cameras[start.camera_of[number]]
        placed[name] = _placed(location, fit.bundle, number, changed, covariance, start.extent)
    return placed


class _Start:
    """The model of `extended` before its adjustment, in pixels as stored. added: ids of the images
    that `model` lacks; a photograph of the walk may have the name of one.

    Attributes:
        index: By image id, the number of each picture with a pose.
        poses: cam_from_world (N, 3, 4).
        cameras: Of the pictures, each once.
        camera_of: (N,) their numbers.
        points: (P, 3) world.
        extent: The largest distance of two pictures of the walk.
    """

    def __init__(
        self, model: Model, whole: pycolmap.Reconstruction, added: Collection[int] = ()
    ) -> None:
        self._model = model
        self._whole = whole
        self._images = [image for image in whole.images.values() if image.has_pose]
        self._ids = sorted({image.camera_id for image in self._images})
        self._by_name = {
            image.name.removeprefix(WALK): number
            for number, image in enumerate(self._images)
            if image.image_id not in added
        }
        self._point_index = {key: index for index, key in enumerate(whole.points3D)}
        self.index = {image.image_id: number for number, image in enumerate(self._images)}
        self.poses = np.stack([image.cam_from_world().matrix() for image in self._images])
        self.cameras = [start_camera(whole.cameras[number]) for number in self._ids]
        self.camera_of = [self._ids.index(image.camera_id) for image in self._images]
        self.extent = model.extent
        self.points = np.array([p.xyz for p in whole.points3D.values()]).reshape(-1, 3)

    def camera(self, number: int) -> Camera:
        """The camera of a picture."""
        return self.cameras[self.camera_of[number]]

    def stated(self, cameras: Mapping[str, Camera]) -> dict[int, Camera]:
        """By their numbers, the cameras of the model's images, for the pixels as stored. cameras:
        of the upright images, by name."""
        found: dict[int, Camera] = {}
        for name, number in self._by_name.items():
            turned = cameras[name].turned(*to_stored(self._model.root / name))
            found.setdefault(self.camera_of[number], turned)
        return found

    def known_observed(self, image_ids: Collection[int]) -> list[Observed]:
        """The points that COLMAP saw in images."""
        parts = list[Observed]()
        for number in (self.index[image_id] for image_id in image_ids):
            shown = [p for p in self._images[number].points2D if p.has_point3D()]
            if shown:
                which = np.array([self._point_index[point.point3D_id] for point in shown])
                seen = np.stack([point.xy for point in shown]) - HALF_PIXEL
                parts.append(self._observed(number, which, seen))
        return parts

    def observed(self, image_id: int, location: Location) -> list[Observed]:
        """The points of the model that a located camera shows."""
        agreeing = [image for image in location.database_images if image.agrees]
        which = np.concatenate([image.points for image in agreeing])
        seen = np.concatenate([image.seen for image in agreeing])
        return [self._observed(self.index[image_id], which, seen)] if len(which) else []

    def _observed(self, number: int, which: np.ndarray, seen: np.ndarray) -> Observed:
        """Points of the model (n,) int at the pixels (n, 2) of a picture; of several pixels of a
        point, the nearest to where it should be."""
        pose = self.poses[number]
        camera = self.camera(number)
        local = self.points[which] @ pose[:, :3].T + pose[:, 3]
        normalised = camera.normalise(seen)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.abs(local[:, :2] / local[:, 2:] - normalised).max(1)
        error[~np.isfinite(error) | (local[:, 2] <= 0)] = np.inf
        order = np.argsort(error, kind="stable")
        order = order[np.isfinite(error[order])]
        chosen = order[np.unique(which[order], return_index=True)[1]]
        median = float(np.median(error[chosen])) if len(chosen) else 0.0
        threshold = max(_MAX_ERROR_PX / camera.focal, _WIDE * median)
        return Observed(number, which[chosen], normalised[chosen], threshold)

    def matched(self, image_id: int, location: Location) -> list[Matched]:
        """The matches of a located camera with the pictures that agree with it."""
        parts = []
        for image in location.database_images:
            if not image.agrees:
                continue
            pair = self._by_name[image.name], self.index[image_id]
            turn, size = to_stored(self._model.root / image.name)
            points1 = turn_points(image.matches.points1, turn, size)
            matches = replace(image.matches, points1=points1)
            cameras = self.camera(pair[0]), self.camera(pair[1])
            parts.append(Matched(pair, TwoViewProblem.of(matches, *cameras)))
        return parts

    def final_cameras(self, bundle: Bundle) -> list[Camera]:
        """The cameras after the adjustment."""
        return [
            with_parameters(camera, fitted.parameters)
            for camera, fitted in zip(self.cameras, bundle.cameras, strict=True)
        ]

    def write(self, bundle: Bundle, cameras: Sequence[Camera], added: Collection[int]) -> None:
        """Change the model to the adjusted one. cameras: from `final_cameras`. added: the pictures
        whose observations are new."""
        for number, image in enumerate(self._images):
            R = bundle.R[number]
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ bundle.centres[number])
            self._whole.frames[image.frame_id].rig_from_world = pose
        for number, camera in zip(self._ids, cameras, strict=True):
            theirs = colmap_camera(camera, self._whole.cameras[number].model.name)
            self._whole.cameras[number].model = theirs.model
            self._whole.cameras[number].params = theirs.params.tolist()
        keys = [*self._point_index]
        for key, xyz in zip(keys, bundle.points, strict=True):
            self._whole.points3D[key].xyz = xyz
        for part in bundle.observed:
            if part.image not in added:
                continue
            image = self._images[part.image]
            pixels = self.camera(part.image).project(part.seen) + HALF_PIXEL
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
            for index, point in enumerate(part.points):
                element = pycolmap.TrackElement(image.image_id, index)
                self._whole.add_observation(keys[point], element)
        self._whole.update_point_3d_errors()


def start_camera(theirs: pycolmap.Camera) -> Camera:
    """The camera of COLMAP; a RADIAL lens with two focal lengths, which is OPENCV there, as
    RADIAL."""
    camera = matrix_camera(theirs)
    lens = camera.distortion
    if lens is None or lens.model != "OPENCV" or any(lens.coefficients[2:]):
        return camera
    return replace(camera, distortion=Distortion(RADIAL, lens.coefficients[:2]))


def bundle_camera(start: Camera, stated: Camera) -> BundleCamera:
    """A camera of the adjustment. stated: the same camera as stated or assumed; its pixels stay as
    they are, and only what is uncertain is open."""
    likely = nearest_part(stated, start.focal)
    if not have_same_lens(start, likely):
        likely = replace(likely, distortion=start.distortion)
    wide = likely
    if stated.focal_source != "given":  # as in a location, see `LocationSearch`
        centre_std = max(stated.centre_std, MOUNTED_STD * max(image_size(start)))
        wide = replace(likely, centre_std=centre_std, lens_std=max(stated.lens_std, LENS_STD))
    stds = np.array(parameter_stds(wide))
    expected = between(start, likely)
    return BundleCamera(start.distortion, np.diag(stds)[:, stds > 0], expected, np.zeros(SIZE))


def _placed(
    location: Location,
    bundle: Bundle,
    number: int,
    changed: Camera,
    covariance: np.ndarray,
    extent: float,
) -> Location:
    """The location of picture `number` after the adjustment, which changed its camera. covariance:
    of all columns. extent: of the model."""
    fitted = bundle.cameras[bundle.camera_of[number]]
    assumed = location.camera
    assert assumed is not None and location.covariance is not None  # of a location
    camera = replace(assumed, K=changed.K, distortion=changed.distortion)
    if not assumed.exact:
        own = bundle.camera_columns(number)
        variances = (fitted.basis @ covariance[np.ix_(own, own)] @ fitted.basis.T).diagonal()
        most = np.square(fitted.basis).sum(axis=1)  # what was stated is not widened
        camera = camera.with_deviations(np.minimum(variances, most))
    pose = bundle.columns[number]
    by_pose = covariance[np.ix_(pose, pose)] * (_EXACT_FACTOR**2 if assumed.exact else 1.0)
    return replace(
        location.with_covariance(by_pose, extent),
        R=bundle.R[number],
        centre=bundle.centres[number],
        camera=camera,
    )


def in_metres(location: Location, pose: np.ndarray, scale: float) -> Location:
    """The location with its pose (3, 4) in a frame that is scaled by `scale`."""
    assert location.R is not None
    turn = np.eye(6)
    turn[3:, 3:] = scale * pose[:, :3].T @ location.R
    return location.with_pose(pose, turn)
