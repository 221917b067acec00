"""Refinement: matches at the accuracy of the original photographs."""

from dgc_pose.refinement.refiner import RefinementOptions, Refiner, SourceName

__all__ = ["RefinementOptions", "Refiner", "SourceName"]
