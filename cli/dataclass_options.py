"""Command-line options made of the fields of a dataclass.

    @click.command()
    @dataclass_options(EstimationOptions, "estimation")
    def estimate(estimation: EstimationOptions) -> None: ...

gives the command an option for each field of `EstimationOptions` that was made by
`dgc_pose.options.option` with a help text, and hands it one instance. A field whose type is such a
dataclass itself contributes that class's options.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click

from dgc_pose.options import OptionInfo, field_types, option_info

Command = Callable[..., Any]


def dataclass_options(
    cls: type,
    argument: str,
    *,
    only: Collection[str] | None = None,
    defaults: Any = None,
) -> Callable[[Command], Command]:
    """A decorator that adds the options of `cls` and passes an instance as keyword `argument`.

    only: names of the fields that become options; None: all with a help text. defaults: an
    instance that other values are taken from, the options' defaults too; None: the class's own.

    The type decides the option: bool is a switch (--x, or --x/--no-x if it is True by default),
    Literal a choice, tuple[X, ...] may be given several times. An InputError of `__post_init__`
    reaches the caller, and thereby the user as one line.
    """
    chosen = list(_chosen(cls, only, defaults, argument))

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def with_instance(*args: Any, **kwargs: Any) -> Any:
            values = {one.name: kwargs.pop(one.name) for one in chosen}
            return command(*args, **kwargs, **{argument: _made(cls, values, defaults, argument)})

        decorated: Command = with_instance
        for one in reversed(chosen):
            decorated = one.decorate(decorated)
        return decorated

    return decorate


@dataclass(frozen=True)
class _Option:
    name: str  # of the command's parameter: the argument and the path of fields, joined by "__"
    flag: str
    kind: Any
    default: Any  # MISSING: required
    info: OptionInfo

    def decorate(self, command: Command) -> Command:
        return click.option(self.flag, self.name, **self._settings())(command)

    def _settings(self) -> dict[str, Any]:
        settings: dict[str, Any] = {"help": self.info.help, "metavar": self.info.metavar}
        if self.default is MISSING:
            settings["required"] = True
        else:
            settings["default"] = self.default
        if self.kind is bool:
            return {**settings, "is_flag": True}
        if get_origin(self.kind) is tuple and self.info.parse is None:
            kind = get_args(self.kind)[0]
            return {**settings, "multiple": True, "type": _parameter_type(kind, self.info)}
        settings["type"] = _parameter_type(self.kind, self.info)
        return {**settings, "show_default": self.default not in (MISSING, None)}


def _chosen(cls: type, only: Collection[str] | None, defaults: Any, path: str) -> Iterator[_Option]:
    types = field_types(cls)
    for field in fields(cls):
        if only is not None and field.name not in only:
            continue
        kind, optional = types[field.name]
        name, info = f"{path}__{field.name}", option_info(field)
        if info is not None and info.help:
            default = field.default if defaults is None else getattr(defaults, field.name)
            if info.text is not None and default == field.default:
                default = info.text
            flag = info.flag or "--" + field.name.replace("_", "-")
            if kind is bool and default is True:
                flag += "/--no-" + flag[2:]
            yield _Option(name, flag, kind, default, info)
        elif isinstance(kind, type) and is_dataclass(kind) and not optional:
            inner = _default(field) if defaults is None else getattr(defaults, field.name)
            yield from _chosen(kind, None, inner, name)


def _made(cls: type, values: Mapping[str, Any], defaults: Any, path: str) -> Any:
    """An instance of the options' values, which `_chosen` named."""
    arguments: dict[str, Any] = {}
    for field in fields(cls):
        name = f"{path}__{field.name}"
        if name in values:
            arguments[field.name] = values[name]
        elif any(other.startswith(name + "__") for other in values):
            kind = field_types(cls)[field.name][0]
            inner = _default(field) if defaults is None else getattr(defaults, field.name)
            arguments[field.name] = _made(kind, values, inner, name)
        elif defaults is not None and field.init:
            arguments[field.name] = getattr(defaults, field.name)
    return cls(**arguments)


def _default(field: Any) -> Any:
    """A field's default; None if it has none."""
    if field.default_factory is not MISSING:
        return field.default_factory()
    return None if field.default is MISSING else field.default


class _Parsed(click.ParamType):
    """What the option's own function makes of its text."""

    name = "text"

    def __init__(self, parse: Callable[[str], Any]) -> None:
        self._parse = parse

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        return self._parse(value) if isinstance(value, str) else value


class _Choice(click.Choice):
    """One of a Literal's values, which need not be text."""

    def __init__(self, values: tuple[Any, ...]) -> None:
        super().__init__([str(value) for value in values])
        self._values = {str(value): value for value in values}

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        return self._values[super().convert(str(value), param, ctx)]


def _parameter_type(kind: Any, info: OptionInfo) -> Any:
    if info.parse is not None:
        return _Parsed(info.parse)
    if get_origin(kind) is Literal:
        return _Choice(get_args(kind))
    if kind is Path:
        return click.Path(path_type=Path)
    if kind in (str, int, float):
        return kind
    raise TypeError(f"no command-line option can be made of {kind}: give a parse function")
