"""Formats of files that cameras are read from."""
