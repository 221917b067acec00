"""Fixed cameras with a pose in one frame: their files, and what changed between calibrations."""
