"""Pairs and views in the light that they were made in."""

from dgc_pose.training.synthesis.options import PhotometricOptions

STILL = PhotometricOptions(
    gain=0,
    gamma=0,
    contrast=0,
    saturation=0,
    shade=0,
    clip=0,
    blur_share=0,
    motion_share=0,
    noise=0,
    shot_noise=0,
    jpeg_share=0,
)
