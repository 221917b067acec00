"""Formats of camera files."""
