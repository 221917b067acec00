"""Refinement: matches at the accuracy of the original photographs, whatever the matcher."""

from dgc_pose.refinement.options import (
    AlignmentOptions,
    FeatureOptions,
    RefinementOptions,
    SourceName,
)
from dgc_pose.refinement.refiner import Refiner

__all__ = ["AlignmentOptions", "FeatureOptions", "RefinementOptions", "Refiner", "SourceName"]
