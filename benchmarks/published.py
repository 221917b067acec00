"""Published figures of dense matching at 240x240, as their authors printed them.

"paper" is Melekhov et al., DGC-Net: Dense Geometric Correspondence Network, WACV 2019; GLU-Net is
Truong et al., CVPR 2020; RANSAC-Flow is Shen et al., ECCV 2020.
"""

from __future__ import annotations

# AEPE on HPatches, viewpoints I to V, pixels.
HPATCHES_AEPE: dict[str, tuple[float, ...]] = {
    "PWC-Net (paper)": (4.43, 11.44, 15.47, 20.17, 28.30),
    "Rocco aff+tps, T (paper)": (9.59, 18.55, 21.15, 27.83, 35.19),
    "DGC-Net (paper)": (1.55, 5.53, 8.98, 11.66, 16.70),
    "DGC+M-Net (paper)": (2.97, 6.85, 9.95, 12.87, 19.13),
    "GLU-Net": (0.59, 4.05, 7.64, 9.82, 14.89),
    "RANSAC-Flow (author's rerun)": (0.52, 2.33, 3.19, 5.35, 5.25),
}
# Jaccard of the mask on HPatches, viewpoints I to V.
HPATCHES_JACCARD: dict[str, tuple[float, ...]] = {
    "DGC+M-Net aff+tps+homo (paper)": (0.730, 0.687, 0.629, 0.590, 0.525),
}
# On the paper's own synthetic pairs, Table 1.
SYNTHETIC = (
    "paper, Table 1, affine and affine + thin-plate-spline pairs of its own photographs: "
    "DGC+M-Net aff+tps AEPE 0.82 to 0.96, Jaccard 0.85; DGC-Net AEPE 0.54 to 0.69"
)
