"""Pairs and calibration of the DTU multi-view stereo set."""
