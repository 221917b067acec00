"""Photographs: reading, headers and folders."""
