"""What random scenes and camera pairs may look like."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dgc_pose.errors import InputError


@dataclass(frozen=True)
class SceneOptions:
    """Ranges of random scenes. The look-at distance is near one field of view; units are its width.

    Raises InputError, naming the field, where a range is empty or out of bounds.
    """

    rotation_deg: tuple[float, float] = (2.0, 45.0)  # between viewing directions, uniform
    roll_deg: float = 10.0  # sigma of a further turn about the optical axis
    wild_roll_share: float = 0.1  # share of pairs whose roll has four times that sigma
    distance: tuple[float, float] = (0.8, 1.5)  # camera 1 to look-at point, focal over image size
    elevation_deg: tuple[float, float] = (-5.0, 60.0)  # of camera 1 above the look-at point
    focal: tuple[float, float] = (0.7, 2.0)  # focal length over image size, log-uniform, each view
    principal_offset: float = 0.05  # largest offset of the principal point, of the image size
    zoom: float = 0.35  # largest |log| of the change of apparent size between the views
    look_aside: float = 0.08  # sigma of how far the common point lies off-axis, fields of view
    free_share: float = 0.15  # share of pairs that do not orbit: centre 2 anywhere near centre 1
    quads: int = 2  # tilted rectangles beside the table and the background
    boxes: int = 4
    ellipsoids: int = 3
    presence: float = 0.75  # chance that each of these, the table and the background is there
    object_size: tuple[float, float] = (0.06, 0.3)  # half sizes, log-uniform
    spread: float = 0.55  # objects lie within so much of the look-at point, and half as much up
    background: tuple[float, float] = (0.25, 1.0)  # its distance behind the look-at point
    room_margin: tuple[float, float] = (0.05, 1.0)  # from cameras and objects to the walls
    texture_span: tuple[float, float] = (0.5, 1.6)  # one photo covers so many fields of view
    shading: float = 0.4  # share of the light that depends on the surface's direction; 0: flat
    shadow: float = 0.0  # share of the light lost where something stands before it; costs a cast
    light_change: float = 0.2  # sigma of the light's move between the views, fields of view
    min_overlap: float = 0.2  # share of image 2's pixels that must be visible in image 1
    tries: int = 6  # scenes drawn for a pair of too little overlap; then the best one is taken
    supersample: int = 1  # samples per pixel and direction; above 1 only against aliasing

    def __post_init__(self) -> None:
        self._check_range("rotation_deg", 0.0, 180.0)
        self._check_range("distance", 1e-3, math.inf)
        self._check_range("elevation_deg", -80.0, 80.0)
        self._check_range("background", 0.0, math.inf)
        self._check_range("room_margin", 1e-3, math.inf)
        self._check_range("focal", 1e-3, math.inf)
        self._check_range("object_size", 1e-3, 10.0)
        self._check_range("texture_span", 1e-3, math.inf)
        for name in (
            "wild_roll_share",
            "free_share",
            "presence",
            "shading",
            "shadow",
            "min_overlap",
        ):
            self._check_number(name, 0.0, 1.0)
        for name in ("roll_deg", "zoom", "look_aside", "light_change", "spread"):
            self._check_number(name, 0.0, math.inf)
        self._check_number("principal_offset", 0.0, 0.5)
        for name in ("quads", "boxes", "ellipsoids", "tries", "supersample"):
            value = getattr(self, name)
            smallest = 1 if name in ("tries", "supersample") else 0
            if not isinstance(value, int) or value < smallest:
                raise InputError(f"{name} must be an integer of at least {smallest}, not {value}")

    def _check_range(self, name: str, smallest: float, largest: float) -> None:
        low, high = getattr(self, name)
        if not (smallest <= low <= high <= largest and math.isfinite(high)):
            raise InputError(
                f"{name} must be (low, high) with {smallest} <= low <= high <= {largest}, "
                f"not {(low, high)}"
            )

    def _check_number(self, name: str, smallest: float, largest: float) -> None:
        value = getattr(self, name)
        if not (smallest <= value <= largest and math.isfinite(value)):
            raise InputError(f"{name} must be in [{smallest}, {largest}], not {value}")
