"""What `help()` says of the public names."""

import inspect
import re
from dataclasses import fields, is_dataclass

import pytest

import dgc_pose
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.system.options import option_info

PUBLIC = [getattr(dgc_pose, name) for name in dgc_pose.__all__]
# What fields of public results and options are.
REACHED = [Distortion, Evidence]


def attributes(cls: type) -> dict[str, str]:
    """The names under "Attributes" in the docstring, with what is said of them."""
    section = inspect.getdoc(cls).partition("\nAttributes:\n")[2]
    return dict(re.findall(r"^    (\w+): (\S.*\S)", section, re.MULTILINE))


@pytest.mark.parametrize("value", [*PUBLIC, *REACHED], ids=lambda value: value.__name__)
def test_each_public_name_and_its_members_are_described(value: type) -> None:
    assert inspect.getdoc(value)
    for name, member in inspect.getmembers(value):
        called = inspect.isfunction(member) or isinstance(member, property)
        assert name.startswith("_") or not called or inspect.getdoc(member), name
    if is_dataclass(value):
        described = attributes(value)
        names = [of.name for of in fields(value)]
        assert [name for name in names if name in described] == list(described)  # in their order
        for of in fields(value):
            info = option_info(of)
            assert of.name in described or (info is not None and info.help), of.name
