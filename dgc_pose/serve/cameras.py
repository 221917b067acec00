"""The cameras that a client asks for. No path that it names is opened."""

from __future__ import annotations

import base64
import binascii
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from dgc_pose.cameras.calibration import pair_cameras, parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import scratch_folder
from dgc_pose.images.image import Image

Kind = Literal["auto", "fov", "k", "file"]
MAX_FILE_BYTES = 1_000_000  # of a file of cameras
_MAX_TEXT = 300  # characters of a K


@dataclass(frozen=True)
class CameraRequest:
    """The client's choice of both cameras. Raises InputError for anything else."""

    kind: Kind
    k1: str = ""  # of image 1, or of both: fx,fy,cx,cy or MODEL,width,height,parameters, or auto
    k2: str = ""  # of image 2; empty for k1
    fov_deg: float | None = None  # horizontal field of view of both images
    file_name: str = ""  # of a file of cameras, without its folder
    content: bytes = b""  # of that file

    @classmethod
    def of(cls, data: object) -> CameraRequest:
        """The request in the JSON of a client."""
        kinds = get_args(Kind)
        if not isinstance(data, Mapping) or data.get("kind") not in kinds:
            raise InputError(f"camera must have a kind: {', '.join(kinds)}")
        k1, k2, file_name = (_text(data.get(key, "")) for key in ("k1", "k2", "name"))
        content = _decoded(data.get("content")) if data["kind"] == "file" else b""
        fov = data.get("fov") if data["kind"] == "fov" else None
        if data["kind"] == "fov" and fov is None:
            raise InputError("give the field of view in degrees")
        return cls(data["kind"], k1.strip(), k2.strip(), fov, file_name, content)

    def resolve(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        """The cameras of both images, checked. Raises InputError for the client."""
        if self.kind in ("auto", "fov"):
            return pair_cameras(None, None, image1, image2, fov=self.fov_deg)
        if self.kind == "file":
            return self._of_file(image1, image2)
        names = ("K1", "K2") if self.k2 not in ("", self.k1) else ("K", "K")
        K1, K2 = _value(self.k1, names[0]), _value(self.k2 or self.k1, names[1])
        return pair_cameras(K1, K2, image1, image2, names)

    def texts(self, cameras: tuple[Camera, Camera]) -> tuple[str, str]:
        """The same as the command and the library take it."""
        if self.kind == "auto":
            return "auto", "auto"
        if self.kind == "file":
            return self.file_name, self.file_name
        if self.kind == "k":
            return self.k1, self.k2 or self.k1
        K1, K2 = (camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() for camera in cameras)
        return ",".join(map(repr, K1)), ",".join(map(repr, K2))

    def _of_file(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        with scratch_folder() as folder:
            # A name without a folder, which keeps the ending: the format may depend on it.
            path = folder / (re.sub(r"[^\w.-]", "_", self.file_name)[-50:].lstrip(".") or "K")
            path.write_bytes(self.content)

            def as_named(text: str) -> str:
                return text.replace(str(path), self.file_name)

            def renamed(camera: Camera) -> Camera:
                identity = None if camera.identity is None else as_named(camera.identity)
                return replace(
                    camera, warnings=tuple(map(as_named, camera.warnings)), identity=identity
                )

            try:
                camera1, camera2 = pair_cameras(str(path), str(path), image1, image2, ("K", "K"))
            except InputError as error:
                raise InputError(as_named(str(error))) from None
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
    except (binascii.Error, ValueError):
        raise InputError("the file's content must be in base 64") from None
    if len(data) > MAX_FILE_BYTES:
        raise InputError(f"a file of cameras has at most {MAX_FILE_BYTES / 1e6:g} MB")
    return data
