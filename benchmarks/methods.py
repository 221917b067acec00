"""The matchers and networks of a benchmark, by name."""

from __future__ import annotations

from collections.abc import Sequence

from dgc_pose.errors import InputError
from dgc_pose.matchers import SIFT, load_matcher
from dgc_pose.matching import Matcher, MatchingOptions
from dgc_pose.network.device import choose_device
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.refinement import RefinementOptions

__all__ = ["SIFT", "load_methods", "load_networks"]


def load_methods(
    names: Sequence[str],
    *,
    device: str,
    options: MatchingOptions,
    refinement: RefinementOptions | None = None,
) -> dict[str, Matcher]:
    """Load every method named: `sift`, the name of shipped weights, or a path to weights.

    refinement: of the dense matchers; None for their maps' own matches.

    Raises InputError where there are no names or one stands twice, and WeightsError where weights
    cannot be loaded.
    """
    _check(names)
    return {
        name: load_matcher(name, device=device, matching=options, refinement=refinement)
        for name in names
    }


def load_networks(names: Sequence[str], *, device: str) -> dict[str, DGCNet]:
    """The bare networks of weights, by name or path, frozen and in evaluation mode.

    Raises as `load_methods` does.
    """
    _check(names)
    chosen = choose_device(device)
    return {name: load_network(name, chosen) for name in names}


def _check(names: Sequence[str]) -> None:
    if not names:
        raise InputError("no methods named")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"the method {name} is named twice")
