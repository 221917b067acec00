"""Two-view geometry in float64: rotations, epipolar distances, depths, homographies."""
