"""Refinement: matches at the accuracy of the original photographs."""

from dgc_pose.refinement.options import RefinementOptions, SourceName
from dgc_pose.refinement.refiner import Refiner

__all__ = ["RefinementOptions", "Refiner", "SourceName"]
