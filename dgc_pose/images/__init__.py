"""Photographs: reading, headers, folders."""
