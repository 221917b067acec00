"""The cameras that a client asks for, none of which is a file."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera, checked_camera, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.serve.store import StoredImage

Kind = Literal["k", "fov", "auto"]
_MAX_TEXT = 300  # characters of a K


@dataclass(frozen=True)
class CameraRequest:
    """What the client said of both cameras. Raises InputError for anything else."""

    kind: Kind
    k1: str = ""  # of image 1, or of both: fx,fy,cx,cy or MODEL,width,height,parameters
    k2: str = ""  # of image 2; empty for k1
    fov_deg: float = 60.0  # horizontal field of view of both images

    @classmethod
    def of(cls, data: object) -> CameraRequest:
        """The request in the JSON of a client."""
        if not isinstance(data, Mapping) or data.get("kind") not in ("k", "fov", "auto"):
            raise InputError("camera must have a kind: k, fov or auto")
        k1, k2 = (_text(data.get(name, "")) for name in ("k1", "k2"))
        fov = data.get("fov", cls.fov_deg)
        if isinstance(fov, bool) or not isinstance(fov, (int, float)) or not 1 <= fov <= 170:
            raise InputError("the field of view must lie between 1 and 170 degrees")
        return cls(data["kind"], k1, k2, float(fov))

    def resolve(self, image1: StoredImage, image2: StoredImage) -> tuple[Camera, Camera]:
        """The cameras of both images, checked. Raises InputError for the client."""
        return self._camera(image1, self.k1, "K"), self._camera(image2, self.k2 or self.k1, "K2")

    def _camera(self, image: StoredImage, text: str, name: str) -> Camera:
        if self.kind == "auto":
            return guess_camera(image.path)
        if self.kind == "fov":  # from edge to edge, the principal point the middle
            width, height = image.size
            focal = width / 2 / math.tan(math.radians(self.fov_deg) / 2)
            K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
            return Camera(K, image.size)
        if not text.strip():
            raise InputError("give K: fx,fy,cx,cy in pixels, or a COLMAP camera")
        return checked_camera(parse_camera(text, name, files=False), image.size, name)

    def flags(self, cameras: tuple[Camera, Camera]) -> list[str]:
        """The same as words of the command."""
        if self.kind == "auto":
            return ["--guess-focal"]
        k1, k2 = self._texts(cameras)
        return ["--K", k1] if k1 == k2 else ["--K1", k1, "--K2", k2]

    def python(self, cameras: tuple[Camera, Camera], names: tuple[str, str]) -> tuple[str, str]:
        """The same as expressions in Python."""
        function = "guess_camera" if self.kind == "auto" else "parse_camera"
        texts = names if self.kind == "auto" else self._texts(cameras)
        return f"{function}({texts[0]!r})", f"{function}({texts[1]!r})"

    def _texts(self, cameras: tuple[Camera, Camera]) -> tuple[str, str]:
        if self.kind == "k":
            return self.k1.strip(), (self.k2 or self.k1).strip()
        k1, k2 = (
            ",".join(map(repr, camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist())) for camera in cameras
        )
        return k1, k2


def command(names: tuple[str, str], flags: list[str], weights: list[str]) -> str:
    """The command that gives the same pose. A name is never an option of it."""
    files = [f"./{name}" if name.startswith("-") else name for name in names]
    return shlex.join(["dgc-pose", "estimate", *files, *flags, *weights])


def python_text(names: tuple[str, str], cameras: tuple[str, str], matcher: str) -> str:
    """The Python that gives the same pose."""
    imports = "from dgc_pose import load_matcher, parse_camera, trace_relative_pose"
    if cameras[0].startswith("guess_camera"):
        imports = imports.replace("parse_camera, ", "")
        imports += "\nfrom dgc_pose.cameras.camera import guess_camera"
    return (
        f"{imports}\n\n"
        f"trace = trace_relative_pose(\n"
        f"    {names[0]!r},\n    {names[1]!r},\n    {cameras[0]},\n    {cameras[1]},\n"
        f"    matcher=load_matcher({matcher}),\n)\n"
        f"print(trace.pose.status, trace.pose.R, trace.pose.t)\n"
    )


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > _MAX_TEXT:
        raise InputError(f"K must be a text of at most {_MAX_TEXT} characters")
    return value
