"""Curriculum learning: narrow warps and small camera motion first, full ranges later."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dgc_pose.synthesis.options import PairOptions, SceneOptions, WarpOptions
from dgc_pose.system.options import check_options, option


@dataclass(frozen=True)
class Curriculum:
    """Ranges grow linearly from a share of the full ones to all of them."""

    start: float = option(0.3, above=0, max=1)  # of the full ranges, at the beginning
    ramp: float = option(0.5, above=0, max=1)  # of the run's progress, then the ranges are full

    def __post_init__(self) -> None:
        check_options(self)

    def at(self, progress: float, options: PairOptions) -> PairOptions:
        """The options of pairs at a progress of the run from 0 to 1, from the full `options`.

        Photometric changes, occluders and the kinds' shares are unchanged.
        """
        reach = min(1.0, self.start + (1 - self.start) * max(0.0, progress) / self.ramp)
        if reach == 1:
            return options
        return replace(
            options,
            warps=_narrowed_warps(options.warps, reach),
            scenes=_narrowed_scenes(options.scenes, reach),
        )


def _narrowed_warps(full: WarpOptions, reach: float) -> WarpOptions:
    return replace(
        full,
        singular_values=_towards_one(full.singular_values, reach),
        affine_rotation_deg=reach * full.affine_rotation_deg,
        homography_rotation_deg=reach * full.homography_rotation_deg,
        any_rotation_share=reach * full.any_rotation_share,
        translation=reach * full.translation,
        tps_sigma=reach * full.tps_sigma,
        corner_shift=reach * full.corner_shift,
        homography_scale=_towards_one(full.homography_scale, reach),
    )


def _narrowed_scenes(full: SceneOptions, reach: float) -> SceneOptions:
    low, high = full.rotation_deg
    return replace(
        full,
        rotation_deg=(low, low + reach * (high - low)),
        roll_deg=reach * full.roll_deg,
        wild_roll_share=reach * full.wild_roll_share,
        log_scale=reach * full.log_scale,
        free_share=reach * full.free_share,
    )


def _towards_one(limits: tuple[float, float], reach: float) -> tuple[float, float]:
    """Factors on a logarithmic scale: their logarithms shrink to `reach`."""
    return limits[0] ** reach, limits[1] ** reach
