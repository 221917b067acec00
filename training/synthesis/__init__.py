"""Pairs of images with a known map: warped photographs, ray-cast scenes, posed depth."""
