"""Fixed cameras with poses in one frame: their files, and changes between two calibrations."""
