"""Cameras: K, lenses, and COLMAP's cameras, models and databases."""
