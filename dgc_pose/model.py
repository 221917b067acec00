"""A model: images with cameras, poses and optional points, from COLMAP, NeRF or a table.

The centre of the top-left pixel is (0.5, 0.5) in COLMAP and (0, 0) in a `Model`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dgc_pose.cameras.by_image import Calibration, orientation_of
from dgc_pose.cameras.camera import Camera, colmap_camera, matrix_camera
from dgc_pose.cameras.formats.colmap import model_calibration, read_model
from dgc_pose.cameras.formats.recognise import read_file
from dgc_pose.errors import ArgumentName, DgcPoseError, ImageError, InputError
from dgc_pose.geometry.pixels import exif_turn, turn_points
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.images.decoding import image_header
from dgc_pose.images.image import size_in_file
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import naming_path, replaced_folder
from dgc_pose.system.texts import write_json

HALF_PIXEL = 0.5  # offset of COLMAP's pixel coordinates
_MODEL_FILES = {"cameras", "images", "points3D", "frames", "rigs", "project"}  # without endings
_NO_POINTS = np.zeros((0, 3))
# Lenses that nerfstudio supports, and its names for COLMAP's parameters.
_PERSPECTIVE = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
_FISHEYE = {"SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"}
_NERFSTUDIO = {"f": "fl_x", "fx": "fl_x", "fy": "fl_y", "k": "k1"}


@dataclass(frozen=True, eq=False)
class Model:
    """Upright images of one folder with their cameras and poses, all in one frame and unit.

    Attributes:
        root: Folder of the image names.
        cameras: Cameras by image name, with the size of the image.
        poses: cam_from_world (3, 4), [R | t] with x = R X + t, by image name.
        points: Points (N, 3) float64, world; N may be 0.
        colours: Colours (N, 3) uint8, RGB, of the points.
        seen: By image name, the indices (M,) of the points that the image shows, and their pixels
            (M, 2). An image that shows none has no entry.
        warnings: Sentences about what is missing, for people.
        colmap: COLMAP's reconstruction, in pixels as stored, with the tracks and all images; None
            for other formats, and without points.
        colmap_names: By name, what `colmap` calls an image, where that is another name.
        bad: By name, why images that are there are not used; also in `warnings`.
    """

    root: Path
    cameras: Mapping[str, Camera]
    poses: Mapping[str, np.ndarray]
    points: np.ndarray = field(default_factory=_NO_POINTS.copy)
    colours: np.ndarray = field(default_factory=lambda: _NO_POINTS.astype(np.uint8))
    seen: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    colmap: pycolmap.Reconstruction | None = None
    colmap_names: Mapping[str, str] = field(default_factory=dict)
    bad: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_colmap(cls, colmap: pycolmap.Reconstruction, root: Path) -> Model:
        """COLMAP's model of the images in the folder `root`. Assumes that they have no EXIF
        orientation, and reads no file. Raises InputError for a camera without a focal length."""
        points = [*colmap.points3D.values()]
        index = {key: number for number, key in enumerate(colmap.points3D)}
        images = [image for image in colmap.images.values() if image.has_pose]
        seen = {}
        for image in images:
            if observed := [point for point in image.points2D if point.has_point3D()]:
                which = np.array([index[point.point3D_id] for point in observed])
                seen[image.name] = which, np.stack([p.xy for p in observed]) - HALF_PIXEL
        return cls(
            root,
            {image.name: matrix_camera(image.camera) for image in images},
            {image.name: np.array(image.cam_from_world().matrix()) for image in images},
            np.array([point.xyz for point in points]).reshape(-1, 3),
            np.array([point.color for point in points], np.uint8).reshape(-1, 3),
            seen,
            colmap=colmap,
        )

    def centre(self, name: str) -> np.ndarray:
        """Position (3,) of a camera, world."""
        pose = self.poses[name]
        centre: np.ndarray = -pose[:, :3].T @ pose[:, 3]
        return centre

    @cached_property
    def extent(self) -> float:
        """The largest distance between two cameras, in the model's unit."""
        centres = np.stack([self.centre(name) for name in self.poses])
        return max(float(np.linalg.norm(centres - centre, axis=1).max()) for centre in centres)

    def require_addable(self, out: Path, paths: Iterable[str | Path]) -> None:
        """Raise InputError if the folder `out` contains files that are not part of a model, if an
        image of these paths has the name of another one or of an image of the model (even of one
        whose file is missing), or if its pixels as stored are a mirror image. An image that
        cannot be read is not checked: it cannot be added."""
        require_model_folder(out)
        known = self.colmap.images.values() if self.colmap else ()
        names = {*self.poses} | {image.name for image in known}
        for path in map(Path, paths):
            try:
                orientation = image_header(path).exif.orientation
            except ImageError:
                continue
            if path.name in names:
                known_name = f"has an image {path.name} already: rename {path}"
                raise InputError(ArgumentName("add"), known_name)
            if np.linalg.det(exif_turn(orientation)) < 0:
                mirrored = f"by EXIF orientation {orientation} its pixels are a mirror image"
                raise InputError(f"{path}: {mirrored}")
            names.add(path.name)

    def write(self, folder: Path, added: Mapping[Path, tuple[Camera, np.ndarray]]) -> None:
        """Write the result of `extended` as COLMAP's binary files, replacing the folder. Raises
        InputError as `extended`; OSError."""
        written = self.extended(added)
        with replaced_folder(folder) as new:
            written.write_binary(new)

    def extended(self, added: Mapping[Path, tuple[Camera, np.ndarray]]) -> pycolmap.Reconstruction:
        """A copy of `colmap`, or a reconstruction of the cameras and poses if it is None, in pixels
        as stored, with further images.

        added: by file, the camera and cam_from_world (3, 4) of each upright image. Each gets its
        own camera and no points. Raises InputError if COLMAP cannot represent a camera.
        """
        images = [(path.name, path, *view) for path, view in added.items()]
        if self.colmap is not None:
            written = pycolmap.Reconstruction(self.colmap)
        else:
            written = pycolmap.Reconstruction()
            poses = self.poses
            images = [(n, self.root / n, self.cameras[n], poses[n]) for n in poses] + images
        for name, path, camera, pose in images:
            header = image_header(path)
            turn = exif_turn(header.exif.orientation).T
            pose = np.concatenate([turn @ pose[:2], pose[2:]])
            theirs = colmap_camera(camera.turned(turn, header.size), name)
            theirs.camera_id = max(written.cameras, default=0) + 1
            written.add_camera_with_trivial_rig(theirs)
            image = pycolmap.Image(name=name, camera_id=theirs.camera_id)
            image.image_id = max(written.images, default=0) + 1
            cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
            written.add_image_with_trivial_frame(image, cam_from_world)
        return written


def load_model(source: str | os.PathLike[str], images: str | os.PathLike[str]) -> Model:
    """The model in a file or folder, with its images in the folder `images`.

    source: the folder of a COLMAP model or of `dgc-pose reconstruct`; NeRF's transforms.json; or a
    .csv with name, qw, qx, qy, qz, tx, ty, tz of cam_from_world and fx, fy, cx, cy. Skips images
    that are missing, broken or mirrored, or that their camera does not fit, with a warning.

    Raises InputError if there are no poses, several models, or a pose that is not rigid; InputError
    or ImageError if fewer than two images are left; OSError.
    """
    path = model_path(Path(source))
    root = Path(images)
    if not root.is_dir():
        raise InputError(ArgumentName("images"), f"{root}: no such folder")
    file, colmap = read_model(path, whole=True) if path.is_dir() else (read_file(path), None)
    if not file.poses:
        raise InputError(ArgumentName("model"), f"{path} has no poses of images")
    has_points = any((path / f"points3D.{ending}").is_file() for ending in ("bin", "txt"))
    return _upright(file, colmap if has_points else None, path, root)


def upright_model(colmap: pycolmap.Reconstruction, root: Path) -> Model:
    """COLMAP's model of the images in the folder `root`, as `load_model` reads it from a file."""
    return _upright(model_calibration(colmap, root), colmap, root, root)


def _upright(
    file: Calibration, colmap: pycolmap.Reconstruction | None, path: Path, root: Path
) -> Model:
    """The model of upright images. file: the cameras and poses of the images as stored. path: of
    the file, for errors and for names relative to it."""
    calibration = Calibration(str(path), parts=file.parts, common=file.common)
    names = {name: _image_name(root, name, path.parent) for name in file.poses}
    if len(names) < 2:
        raise InputError(ArgumentName("model"), f"{path} has one posed image, and two are needed")
    missing = sorted(name for name, there in names.items() if there is None)
    count = f"{len(missing)} of {len(names)} images (first: {', '.join(missing[:3])})"
    if len(names) - len(missing) < 2:
        raise InputError(ArgumentName("images"), f"{root} lacks {count} of {path}")
    whole = None if colmap is None else Model.of_colmap(colmap, root)
    cameras = {}
    poses = {}
    seen = {}
    failures: dict[str, DgcPoseError] = {}
    for stated, name in names.items():
        pose = file.poses[stated]
        if not (is_rotation(pose[:, :3]) and np.isfinite(pose).all()):
            raise InputError(ArgumentName("model"), f"{path}: the pose of {stated} is not rigid")
        if name is None:
            continue
        stated_camera = {name: file.by_name[stated]} if stated in file.by_name else {}
        own = replace(calibration, by_name=stated_camera)
        try:
            header = image_header(root / name)
            camera = own.camera(root, name, header)
            # Poses for the pixels as stored are rotated with the image.
            K = own.stated(root, name)
            turn = exif_turn(1 if K is None else orientation_of(K, header))
            if np.linalg.det(turn) < 0:
                raise InputError(f"{root / name}: its pixels as stored are a mirror image, by EXIF")
        except DgcPoseError as error:  # the other images are a model too
            failures[name] = error
            continue
        cameras[name] = replace(camera.as_exact(), size=header.size)  # the poses belong to it
        poses[name] = np.concatenate([turn @ pose[:2], pose[2:]])
        if whole is not None and stated in whole.seen:
            which, pixels = whole.seen[stated]
            seen[name] = which, turn_points(pixels, turn, size_in_file(header))
    if failures and len(poses) < 2:
        raise next(iter(failures.values()))
    bad = {name: str(failure) for name, failure in failures.items()}
    lacks = [f"{root} lacks {count} of {path}"] if missing else []
    warnings = (*lacks, *(f"not used: {why}" for why in bad.values()))
    model = whole or Model(root, cameras, poses)
    others = dict[str, str]()
    if whole is not None:
        others = {name: stated for stated, name in names.items() if name and name != stated}
    return replace(
        model,
        cameras=cameras,
        poses=poses,
        seen=seen,
        warnings=warnings,
        colmap_names=others,
        bad=bad,
    )


def read_colmap(source: Path) -> pycolmap.Reconstruction:
    """COLMAP's model in a folder. Raises InputError if there is none, or one without poses."""
    path = model_path(source)
    if not path.is_dir():
        raise InputError(ArgumentName("model"), f"{path} is not a folder of COLMAP's files")
    file, colmap = read_model(path, whole=True)
    if not file.poses:
        raise InputError(ArgumentName("model"), f"{path} has no poses of images")
    return colmap


def model_path(path: Path) -> Path:
    """The file, or the folder of COLMAP's files, of a source. Raises InputError without one."""
    if not path.is_dir():
        if not path.exists():
            raise InputError(ArgumentName("model"), f"{path}: no such file or folder")
        return path
    for folders in ("", "*/", "sparse/*/"):  # the last: in a folder of results
        files = [f for ending in ("bin", "txt") for f in path.glob(f"{folders}cameras.{ending}")]
        models = sorted({file.parent for file in files})
        if len(models) > 1:
            listed = ", ".join(folder.name for folder in models)
            raise InputError(ArgumentName("model"), f"{models[0].parent} has the models {listed}")
        if models:
            return models[0]
    raise InputError(ArgumentName("model"), f"{path} contains no COLMAP model")


def _image_name(root: Path, name: str, folder: Path) -> str | None:
    """The path from `root` of the image that a model in `folder` calls `name`; None if there is no
    such file. Tries the name as a path from `root`, then from `folder`, then its last part. NeRF's
    names may lack their ending."""
    stated = os.path.normpath(os.path.join(os.path.realpath(folder), name))
    relative = os.path.relpath(stated, os.path.realpath(root))
    for candidate in dict.fromkeys((os.path.normpath(name), relative, Path(name).name)):
        if candidate.startswith(os.pardir + os.sep):  # outside of the root
            continue
        if os.path.isfile(root / candidate):
            return candidate
        if not Path(candidate).suffix and (root / candidate).parent.is_dir():
            same = sorted((root / candidate).parent.glob(f"{Path(candidate).name}.*"))
            if len(same) == 1:
                return same[0].relative_to(root).as_posix()
    return None


def require_model_folder(folder: Path, *, several: bool = False) -> None:
    """Raise InputError if the folder is a file, or contains files that are not part of a model.

    several: whether it may have the folders 1, 2, ... of further models.
    """
    inside = [*folder.rglob("*")]
    models = {folder / str(number) for number in range(1, several * len(inside))}
    own = (path in models if path.is_dir() else path.stem in _MODEL_FILES for path in inside)
    if not all(own) or (folder.exists() and not folder.is_dir()):
        raise InputError(folder, "contains files that are not part of a model; not overwritten")


def write_points(file: Path, points: np.ndarray, colours: np.ndarray) -> None:
    """Write points (N, 3) and their colours (N, 3) uint8 RGB as PLY. Raises OSError."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    rows = np.hstack([points.astype("<f4", order="C").view(np.uint8), colours])
    with naming_path(file):
        file.write_bytes("\n".join([*lines, "end_header\n"]).encode() + rows.tobytes())


def write_nerfstudio(
    model: pycolmap.Reconstruction, images: Path | None, out: Path, at: Path
) -> None:
    """Write nerfstudio's transforms.json, with world_from_cam for the axes right, up, backwards,
    and points.ply into the empty folder `out`, which the caller then moves to `at`.

    images: folder of the photographs; with it, frames name them by their paths from `at`. Raises
    InputError for a lens that nerfstudio lacks, and for fisheyes beside other lenses; OSError.
    """
    lenses = {image.camera.model.name for image in model.images.values()}
    if not (lenses <= _PERSPECTIVE or lenses <= _FISHEYE):
        raise InputError(ArgumentName("to"), f"nerfstudio cannot hold {', '.join(sorted(lenses))}")
    frames = []
    for _, image in sorted(model.images.items()):
        camera = image.camera
        pose = image.cam_from_world().inverse().matrix() * (1, -1, -1, 1)
        path = image.name
        if images is not None:
            path = os.path.join(os.path.realpath(images, strict=True), path)
            os.stat(path)  # raises OSError if it is not there
            path = os.path.relpath(path, os.path.realpath(at))
        frame = {"file_path": path, "transform_matrix": [*pose.tolist(), [0, 0, 0, 1]]}
        frame |= {"w": camera.width, "h": camera.height, "fl_y": camera.focal_length_y}
        values = zip(camera.params_info.split(", "), camera.params.tolist(), strict=True)
        frames.append(frame | {_NERFSTUDIO.get(name, name): value for name, value in values})
    cloud = Model.of_colmap(model, Path())
    write_points(out / "points.ply", cloud.points, cloud.colours)
    lens = "OPENCV" if lenses <= _PERSPECTIVE else "OPENCV_FISHEYE"
    data = {"camera_model": lens, "ply_file_path": "points.ply", "frames": frames}
    write_json(out / "transforms.json", data)
