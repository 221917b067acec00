"""Cameras: K, lenses, COLMAP's cameras, models and databases."""
