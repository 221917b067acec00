"""Fixed cameras with a pose in one frame: their files, and what changed since another calibration."""
