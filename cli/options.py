"""Command-line options from the fields of a dataclass, and options that several commands share.

    @click.command()
    @dataclass_options(EstimationOptions, "estimation")
    def estimate(estimation: EstimationOptions) -> None: ...

gives the command an option for each field of `EstimationOptions` that
`dgc_pose.system.options.option` made with a help text, and passes an instance to the command. A
field whose type is a dataclass adds the options of that class.
"""

import functools
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click

from dgc_pose.cameras.by_image import KDetails
from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.recognise import FORMATS
from dgc_pose.cli.guard import NamedPath, OutputFile, SectionedOption
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.system.options import OptionInfo, check_options, field_types, option, option_info

_FILE = re.compile(r"PATH|DIR|FILE")  # in the metavar of an option for a path
Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def dataclass_options(
    cls: type, argument: str, *, only: Collection[str] | None = None
) -> Decorator:
    """A decorator that adds the options of `cls`, and passes an instance, checked by
    `check_options`, as keyword `argument`.

    only: names of the fields that become options; None: all fields with a help text. The type of a
    field determines the option: bool is a switch (--x, or --x/--no-x if True by default), Literal a
    choice, and tuple[X, ...] may be given several times.
    """
    chosen = dict(_options(cls, argument, only))

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def with_instance(**kwargs: Any) -> Any:
            values = {name: kwargs.pop(name) for name in chosen}
            return command(**kwargs, **{argument: _made(cls, values, argument)})

        decorated: Command = with_instance
        for decorator in reversed(chosen.values()):
            decorated = decorator(decorated)
        return decorated

    return decorate


def _options(
    cls: type, path: str, only: Collection[str] | None = None
) -> Iterator[tuple[str, Decorator]]:
    """Name and decorator of each option. The name is the path of its fields, joined by "__"."""
    for field in fields(cls):
        kind, optional = field_types(cls)[field.name]
        name = f"{path}__{field.name}"
        info = option_info(field)
        if only is not None and field.name not in only:
            continue
        if info is None or not info.help:
            if isinstance(kind, type) and is_dataclass(kind) and not optional:
                yield from _options(kind, name)
            continue
        flag = info.flag or "--" + field.name.replace("_", "-")
        settings: dict[str, Any] = {"required": field.default is MISSING}
        if field.default is not MISSING:
            settings["default"] = field.default if info.text is None else info.text
        if kind is bool:
            flag += "/--no-" + flag[2:] if field.default else ""
            settings["is_flag"] = True
        elif get_origin(kind) is tuple and info.parse is None:
            settings |= {"multiple": True, "type": _parameter_type(get_args(kind)[0], info)}
        else:
            settings["type"] = _parameter_type(kind, info)
            settings["show_default"] = settings.get("default") is not None
        settings |= {"help": info.help, "metavar": info.metavar, "section": info.section}
        yield name, click.option(flag, name, cls=SectionedOption, **settings)


def _made(cls: type, values: Mapping[str, Any], path: str) -> Any:
    """An instance with the values of the options, by the names of `_options`."""
    arguments: dict[str, Any] = {}
    for field in fields(cls):
        name = f"{path}__{field.name}"
        if name in values:
            arguments[field.name] = values[name]
        elif any(other.startswith(name + "__") for other in values):
            arguments[field.name] = _made(field_types(cls)[field.name][0], values, name)
    made = cls(**arguments)
    check_options(made)
    return made


def _parameter_type(kind: Any, info: OptionInfo) -> Any:
    if info.type is not None:
        return info.type
    if info.parse is not None:
        return click.types.FuncParamType(info.parse)
    if get_origin(kind) is Literal:
        return click.Choice(get_args(kind))
    if kind is Path or (kind is str and _FILE.search(info.metavar or "")):
        # The value of an option such as K|FILE stays text, but may be an input file.
        return click.Path() if "|" in (info.metavar or "") else NamedPath(path_type=kind)
    return kind


def output_file(help: str, metavar: str, **kind: bool) -> Any:
    """A field for an output file, None by default. kind: arguments of `OutputFile`."""
    return option(None, help, metavar=metavar, type=OutputFile(**kind))


_FORMATS = ", ".join(row.name for row in FORMATS if row.name)
_camera = partial(option, None, metavar="K|FILE|auto", section="cameras")
_detail = partial(option, None, section="advanced")


def parse_size(text: str) -> tuple[int, int]:
    """Parse a text WxH. Raises InputError for any other text."""
    match = re.fullmatch(r"0*([1-9]\d{0,5})[xX]0*([1-9]\d{0,5})", text.strip())
    if match is None:
        raise InputError(f"must be WxH in pixels, such as 1600x1200, not {text!r}")
    return int(match[1]), int(match[2])


def parse_deviations(text: str) -> tuple[float, float]:
    """Parse a text F[,C]; C is 0 by default. Raises InputError for any other text."""
    with suppress(ValueError):
        focal, centre = map(float, (text if "," in text else f"{text},0").split(","))
        if 0 <= focal <= 1 and 0 <= centre < 1e6:
            return focal, centre
    raise InputError(
        f"must be F or F,C (relative deviation of f, at most 1; pixels of the principal point), "
        f"not {text!r}"
    )


@dataclass(frozen=True)
class KChoice:
    """The options of a K for all images."""

    k: str | None = _camera(
        f"Camera of all images: fx,fy,cx,cy; COLMAP's MODEL,w,h,params; a file ({_FORMATS}); or "
        "auto, the default: not known (auto:shared: one camera took all images; auto:two: each "
        "has its own).",
        flag="--K",
    )
    k_size: tuple[int, int] | None = _detail(
        "Size of the images that K is for; K is scaled to the photographs.",
        flag="--K-size",
        metavar="WxH",
        parse=parse_size,
    )
    k_std: tuple[float, float] | None = _detail(
        "Standard deviation of f (relative) and of the principal point (px).",
        flag="--K-std",
        metavar="F[,C]",
        parse=parse_deviations,
    )

    @property
    def details(self) -> KDetails:
        """The size and deviations of K."""
        return KDetails(self.k_size, *(self.k_std or ()))


@dataclass(frozen=True)
class CameraChoice(KChoice):
    """The options of the cameras of two images. --K1 and --K2 override --K."""

    k1: str | None = _camera("Camera of image 1; of both images without --K2 and --K.", flag="--K1")
    k2: str | None = _camera("Camera of image 2.", flag="--K2")
    fov: float | None = _camera("Horizontal field of view.", metavar="DEGREES", section="advanced")

    def resolve(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        """The checked cameras of both images; without any option, as with --K auto. Raises
        InputError, naming the option, if a camera is unusable or does not fit its image."""
        name1, text1 = ("--K", self.k) if self.k1 is None else ("--K1", self.k1)
        name2, text2 = ("--K", self.k) if self.k2 is None else ("--K2", self.k2)
        if text2 is None:
            name2 = name1
            text2 = text1
        return pair_cameras(text1, text2, image1, image2, (name1, name2), self.details, self.fov)


@dataclass(frozen=True)
class MaskChoice:
    """The options of the masks of two images."""

    mask1: str | None = option(None, "Black is not matched.", metavar="FILE", section="matching")
    mask2: str | None = option(None, "The same for image 2.", metavar="FILE", section="matching")
