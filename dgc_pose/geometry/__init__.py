"""Two-view geometry in float64: rotations, epipolar distances, triangulation, homographies."""
