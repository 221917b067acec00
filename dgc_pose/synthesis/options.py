"""The ranges of random pairs: warps, scenes, views and light."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dgc_pose.errors import InputError
from dgc_pose.system.options import check_options, option

Range = tuple[float, float]  # (low, high)


@dataclass(frozen=True)
class WarpOptions:
    """Ranges of the random warps. The defaults are the paper's (section 4), measured on its lists.

    Coordinates are normalised: -1 and +1 are the outer edges of the view.
    """

    affine_share: float = option(0.25, min=0, max=1)  # of the pairs
    tps_share: float = option(0.25, min=0, max=1)  # of the pairs; the rest are homographies
    singular_values: Range = (0.75, 1.25)  # of the affine's linear part
    affine_rotation_deg: float = 15.0  # uniform in +- this
    homography_rotation_deg: float = 0.0  # uniform in +- this, in addition to the moved corners
    any_rotation_share: float = 0.0  # of the affine and homography pairs: rotation in +-180 deg
    translation: float = 0.25  # uniform in +- this, normalised
    tps_sigma: float = 0.2  # of the control points, normalised
    corner_shift: float = 2 / 3  # of a homography's corners, normalised: 80 of 240 pixels
    homography_scale: Range = (1.0, 1.0)  # additional scale of a homography, log-uniform

    def __post_init__(self) -> None:
        check_options(self)
        if self.affine_share + self.tps_share > 1:
            raise InputError("affine_share and tps_share must be shares of one")
        if not 0 <= self.corner_shift < 1:
            raise InputError("corner_shift must lie in [0, 1): beyond, corners would cross")


PAPER = WarpOptions()
PAPER_AFFINE = replace(PAPER, affine_share=1.0, tps_share=0.0)
PAPER_AFFINE_TPS = replace(PAPER, affine_share=0.5, tps_share=0.5)
PAPER_HOMOGRAPHY = replace(PAPER, affine_share=0.0, tps_share=0.0)
WIDE = WarpOptions(
    affine_share=0.3,
    tps_share=0.15,
    singular_values=(0.5, 1.6),
    affine_rotation_deg=30.0,
    homography_rotation_deg=30.0,
    any_rotation_share=0.12,
    translation=0.35,
    tps_sigma=0.15,
    corner_shift=0.5,
    homography_scale=(0.6, 1.5),
)
WARPS = {
    "paper-affine": PAPER_AFFINE,
    "paper-affine-tps": PAPER_AFFINE_TPS,
    "paper-homography": PAPER_HOMOGRAPHY,
    "paper": PAPER,
    "wide": WIDE,
}


def named_warps(name: str) -> WarpOptions:
    """The ranges of that name in WARPS. Raises InputError for another name."""
    if name not in WARPS:
        raise InputError(f"warps must be one of {', '.join(WARPS)}, not '{name}'")
    return WARPS[name]


@dataclass(frozen=True)
class SceneOptions:
    """Ranges of random 3D scenes. The unit of length is the width of camera 1's field of view at
    the look-at point, which is about that far from the cameras.

    Raises InputError, naming the field, if a range is empty or out of bounds.
    """

    rotation_deg: Range = option((2.0, 45.0), min=0, max=180)  # between viewing directions
    roll_deg: float = option(10.0, min=0)  # sigma of a further rotation about the optical axis
    wild_roll_share: float = option(0.1, min=0, max=1)  # of pairs whose roll has 4 times that sigma
    # Camera 1 to look-at point, times focal length over image size.
    distance: Range = option((0.8, 1.5), min=1e-3)
    elevation_deg: Range = option((-5.0, 60.0), min=-80, max=80)  # of camera 1, as seen from there
    focal: Range = option((0.7, 2.0), min=1e-3)  # focal length over image size, log-uniform
    principal_offset: float = option(0.05, min=0, max=0.5)  # at most, of the image size
    log_scale: float = option(0.35, min=0)  # largest |log| of the scale between the views
    look_aside: float = option(0.08, min=0)  # sigma of the common point's distance off-axis
    free_share: float = option(0.15, min=0, max=1)  # of pairs with centre 2 anywhere near centre 1
    quads: int = option(2, min=0)  # tilted rectangles beside the table and the background
    boxes: int = option(4, min=0)
    ellipsoids: int = option(3, min=0)
    presence: float = option(0.75, min=0, max=1)  # chance of each of these, table and background
    object_size: Range = option((0.06, 0.3), min=1e-3, max=10)  # half sizes, log-uniform
    spread: float = option(0.55, min=0)  # objects lie this near the look-at point, half as much up
    background: Range = option((0.25, 1.0), min=0)  # its distance behind the look-at point
    room_margin: Range = option((0.05, 1.0), min=1e-3)  # from cameras and objects to the walls
    texture_span: Range = option((0.5, 1.6), min=1e-3)  # length that one photograph covers
    shading: float = option(0.4, min=0, max=1)  # share of the light that depends on the angle
    shadow: float = option(0.0, min=0, max=1)  # share of the light lost in shadow; costs a ray cast
    light_change: float = option(0.2, min=0)  # sigma of the light's motion between the views
    min_overlap: float = option(0.2, min=0, max=1)  # of image 2's pixels, visible in image 1
    tries: int = option(6, min=1)  # scenes drawn for a pair of too little overlap
    supersample: int = option(1, min=1)  # samples per pixel and axis; above 1 against aliasing

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class DepthOptions:
    """How views are cut from frames of known depth, and how the depths of the two are compared."""

    view_scale: Range = option((0.6, 1.0), above=0, max=1)  # of the frame's side
    view_roll_deg: float = 8.0  # standard deviation of the view's rotation in the frame
    # The ratio of the source's depth at a target's pixel to the depth expected there:
    agree: float = 0.02  # within this of 1, the pixel is visible
    hidden: float = 0.05  # smaller than 1 by more, the pixel is occluded; else it is not known

    def __post_init__(self) -> None:
        check_options(self)
        if not 0 < self.agree <= self.hidden < 1:
            raise InputError("agree and hidden must be shares, agree the smaller one")


@dataclass(frozen=True)
class PhotometricOptions:
    """How much the light of two views may differ; each view is changed independently."""

    gain: float = 0.35  # exposure: exp of uniform in +- this; each channel 0.3 times as much
    gamma: float = 0.35  # exp of uniform in +- this
    contrast: float = 0.3  # 1 + uniform in +- this, about the mean
    saturation: float = 0.5  # 1 + uniform in +- this, towards grey
    shade: float = 0.4  # strength of a linear change of light across the view
    clip: float = 0.08  # black and white points move in by at most this; beyond, detail is lost
    blur_share: float = option(0.3, min=0, max=1)  # of the views that are out of focus
    blur_sigma: float = 1.2  # pixels, at most
    motion_share: float = option(0.15, min=0, max=1)  # of the views with motion blur
    motion_length: float = 7.0  # pixels, at most, along a line of any direction
    noise: float = 0.03  # standard deviation at most, of a range of 1, whatever the light
    shot_noise: float = 0.03  # the same at white, growing with the square root of the light
    jpeg_share: float = option(0.3, min=0, max=1)  # of the views
    jpeg_quality: Range = option((25.0, 95.0), min=1, max=100)  # on libjpeg's scale

    def __post_init__(self) -> None:
        check_options(self)
        if not 0 <= self.clip < 0.5:
            raise InputError(f"clip must lie in [0, 0.5), not {self.clip}")


@dataclass(frozen=True)
class PairOptions:
    """Shares of the kinds of pairs, and the ranges of each kind."""

    scene_share: float = option(
        0.5,
        "Share of the pairs that are ray-cast 3D scenes; the rest are warped photographs.",
        min=0,
        max=1,
    )
    real_share: float = option(0.0, min=0, max=1)
    warps: WarpOptions = option(
        WIDE,
        "Ranges of the warps: wide, paper, paper-affine, paper-affine-tps or paper-homography.",
        parse=named_warps,
        text="wide",
    )
    scenes: SceneOptions = field(default_factory=SceneOptions)
    real: DepthOptions = field(default_factory=DepthOptions)
    # None: both views in the photograph's own light.
    photometric: PhotometricOptions | None = field(default_factory=PhotometricOptions)
    view_scale: Range = (0.5, 1.0)  # a warped pair's view, of the photograph's side
    view_roll_deg: float = 20.0  # standard deviation of the view's rotation in the photograph
    occluder_share: float = option(0.3, min=0, max=1)  # of the warped pairs' views

    def __post_init__(self) -> None:
        check_options(self)
        if self.scene_share + self.real_share > 1:
            raise InputError("scene_share and real_share must be shares of one")
