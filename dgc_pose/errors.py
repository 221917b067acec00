"""The errors that dgc-pose raises. They share one base class."""

from __future__ import annotations


class DgcPoseError(Exception):
    """Base of every error that dgc-pose raises; its message is one line, for people."""


class InputError(DgcPoseError, ValueError):
    """An argument of the wrong shape, range or kind; the message names the argument."""


class ImageError(DgcPoseError):
    """An image file that is missing, empty, corrupt or too large; the message holds the path."""


class WeightsError(DgcPoseError):
    """Weights that are missing, unreadable or of another network; the message holds the file."""
