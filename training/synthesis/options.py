"""The ranges of random pairs: warps, scenes, views and light."""

from dataclasses import dataclass

from dgc_pose.errors import InputError
from dgc_pose.system.options import check_options, option

Range = tuple[float, float]  # (low, high)


@dataclass(frozen=True)
class WarpOptions:
    """Ranges of the random warps. The defaults are the paper's (section 4), measured on its lists.

    Coordinates are normalised: -1 and +1 are the outer edges of the view.
    """

    affine_share: float = 0.25  # of the pairs
    tps_share: float = 0.25  # of the pairs; the rest are homographies
    singular_values: Range = (0.75, 1.25)  # of the affine's linear part
    affine_rotation_deg: float = 15.0  # uniform in +- this
    homography_rotation_deg: float = 0.0  # uniform in +- this, in addition to the moved corners
    any_rotation_share: float = 0.0  # of the affine and homography pairs: rotation in +-180 deg
    translation: float = 0.25  # uniform in +- this, normalised
    tps_sigma: float = 0.2  # of the control points, normalised
    corner_shift: float = 2 / 3  # of a homography's corners, normalised: 80 of 240 pixels; below 1
    homography_scale: Range = (1.0, 1.0)  # additional scale of a homography, log-uniform


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
    "paper-affine": WarpOptions(affine_share=1.0, tps_share=0.0),
    "paper-affine-tps": WarpOptions(affine_share=0.5, tps_share=0.5),
    "paper-homography": WarpOptions(affine_share=0.0, tps_share=0.0),
    "paper": WarpOptions(),
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
    the look-at point, which is about that far from the cameras."""

    rotation_deg: Range = (2.0, 45.0)  # between viewing directions
    roll_deg: float = 10.0  # sigma of a further rotation about the optical axis
    log_scale: float = 0.35  # largest |log| of the scale between the views
    quads: int = 2  # tilted rectangles beside the table and the background
    boxes: int = 4
    ellipsoids: int = 3
    presence: float = 0.75  # chance of each of these, table and background
    texture_span: Range = (0.5, 1.6)  # length that one photograph covers
    shading: float = 0.4  # share of the light that depends on the angle
    shadow: float = 0.0  # share of the light lost in shadow; costs a ray cast
    light_change: float = 0.2  # sigma of the light's motion between the views
    min_overlap: float = 0.2  # of image 2's pixels, visible in image 1
    tries: int = 6  # scenes drawn for a pair of too little overlap
    supersample: int = 1  # samples per pixel and axis; above 1 against aliasing


@dataclass(frozen=True)
class DepthOptions:
    """How views are cut from frames of known depth, and how the depths of the two are compared."""

    view_scale: Range = (0.6, 1.0)  # of the frame's side
    view_roll_deg: float = 8.0  # standard deviation of the view's rotation in the frame
    # The ratio of the source's depth at a target's pixel to the depth expected there:
    agree: float = 0.02  # within this of 1, the pixel is visible
    hidden: float = 0.05  # smaller than 1 by more, the pixel is occluded; else it is not known


@dataclass(frozen=True)
class PhotometricOptions:
    """How much the light of two views may differ; each view is changed independently."""

    gain: float = 0.35  # exposure: exp of uniform in +- this; each channel 0.3 times as much
    gamma: float = 0.35  # exp of uniform in +- this
    contrast: float = 0.3  # 1 + uniform in +- this, about the mean
    saturation: float = 0.5  # 1 + uniform in +- this, towards grey
    shade: float = 0.4  # strength of a linear change of light across the view
    clip: float = 0.08  # black and white points move in by at most this; beyond, detail is lost
    blur_share: float = 0.3  # of the views that are out of focus
    blur_sigma: float = 1.2  # pixels, at most
    motion_share: float = 0.15  # of the views with motion blur
    motion_length: float = 7.0  # pixels, at most, along a line of any direction
    noise: float = 0.03  # standard deviation at most, of a range of 1, whatever the light
    shot_noise: float = 0.03  # the same at white, growing with the square root of the light
    jpeg_share: float = 0.3  # of the views
    jpeg_quality: Range = (25.0, 95.0)  # on libjpeg's scale


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
    scenes: SceneOptions = SceneOptions()
    real: DepthOptions = DepthOptions()
    # None: both views in the photograph's own light.
    photometric: PhotometricOptions | None = PhotometricOptions()
    view_scale: Range = (0.5, 1.0)  # a warped pair's view, of the photograph's side
    view_roll_deg: float = 20.0  # standard deviation of the view's rotation in the photograph
    occluder_share: float = option(0.3, min=0, max=1)  # of the warped pairs' views

    def __post_init__(self) -> None:
        check_options(self)
        if self.scene_share + self.real_share > 1:
            raise InputError("scene_share and real_share must be shares of one")
