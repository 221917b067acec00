"""The cameras that a client asks for. No path that it names is opened."""

import base64
import re
import shlex
from collections.abc import Mapping
from dataclasses import replace

from dgc_pose.cameras.calibration import pair_cameras, parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.system.files import scratch_folder

MAX_FILE_BYTES = 1_000_000  # of a file of cameras
_MAX_TEXT = 300  # characters of a K


def requested_cameras(
    data: object, image1: Image, image2: Image
) -> tuple[tuple[Camera, Camera], tuple[str, str]]:
    """The cameras of both images that a client asks for, checked, and each as --K takes it.

    data: the client's JSON: `kind`; of "k" `k1` and `k2`, texts, the second empty if one camera
    took both; of "fov" `fov`, the horizontal field of view of both images, degrees; of "file" its
    `name` without the folder and its `content`, in base 64. Raises InputError for anything else.
    """
    request = data if isinstance(data, Mapping) else {}
    match request.get("kind"):
        case "auto":
            return pair_cameras(None, None, image1, image2), ("auto", "auto")
        case "fov":
            if request.get("fov") is None:
                raise InputError("give the field of view in degrees")
            cameras = pair_cameras(None, None, image1, image2, fov=request["fov"])
            Ks = (camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() for camera in cameras)
            K1, K2 = (",".join(map(repr, K)) for K in Ks)
            return cameras, (K1, K2)
        case "k":
            k1 = _text(request.get("k1", "")).strip()
            k2 = _text(request.get("k2", "")).strip() or k1
            names = ("K", "K") if k1 == k2 else ("K1", "K2")
            first, second = _value(k1, names[0]), _value(k2, names[1])
            return pair_cameras(first, second, image1, image2, names), (k1, k2)
        case "file":
            name = _text(request.get("name", ""))
            content = _decoded(request.get("content"))
            return _of_file(name, content, image1, image2), (name, name)
    raise InputError("camera must have a kind: auto, fov, k, file")


def _of_file(name: str, content: bytes, image1: Image, image2: Image) -> tuple[Camera, Camera]:
    with scratch_folder() as folder:
        # A name without a folder, which keeps the ending: the format may depend on it.
        path = folder / (re.sub(r"[^\w.-]", "_", name)[-50:].lstrip(".") or "K")
        path.write_bytes(content)

        def renamed(camera: Camera) -> Camera:
            warnings = tuple(warning.replace(str(path), name) for warning in camera.warnings)
            identity = camera.identity and camera.identity.replace(str(path), name)
            return replace(camera, warnings=warnings, identity=identity)

        try:
            camera1, camera2 = pair_cameras(str(path), str(path), image1, image2, ("K", "K"))
        except InputError as error:
            raise InputError(str(error).replace(str(path), name)) from None
    return renamed(camera1), renamed(camera2)


def command(names: tuple[str, str], cameras: tuple[str, str], weights: list[str]) -> str:
    """The command that gives the same pose. cameras: as --K takes them."""
    files = [f"./{name}" if name.startswith("-") else name for name in names]
    k1, k2 = cameras
    flags = ["--K", k1] if k1 == k2 else ["--K1", k1, "--K2", k2]
    return shlex.join(["dgc-pose", "estimate", *files, *flags, *weights])


def python_text(names: tuple[str, str], cameras: tuple[str, str], matcher: str) -> str:
    """The Python that gives the same pose."""
    k1, k2 = cameras
    ks = f"K1={k1!r}" if k1 == k2 else f"K1={k1!r},\n    K2={k2!r}"
    return (
        "from dgc_pose import estimate_relative_pose, load_matcher\n\n"
        f"pose = estimate_relative_pose(\n"
        f"    {names[0]!r},\n    {names[1]!r},\n    {ks},\n"
        f"    matcher=load_matcher({matcher}),\n)\n"
        f"print(pose.status, pose.R, pose.t)\n"
    )


def _value(text: str, name: str) -> Camera | str:
    if not text:
        raise InputError("give K: fx,fy,cx,cy in pixels, or a COLMAP camera")
    return text if text == "auto" else parse_camera(text, name, files=False)


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > _MAX_TEXT:
        raise InputError(f"K must be a text of at most {_MAX_TEXT} characters")
    return value


def _decoded(content: object) -> bytes:
    """The bytes of a file, which come in base 64."""
    if not isinstance(content, str) or not content:
        raise InputError("choose a file of cameras")
    try:
        data = base64.b64decode(content, validate=True)
    except ValueError:
        raise InputError("the file's content must be in base 64") from None
    if len(data) > MAX_FILE_BYTES:
        raise InputError(f"a file of cameras has at most {MAX_FILE_BYTES / 1e6:g} MB")
    return data
