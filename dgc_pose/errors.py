"""The errors that dgc-pose raises. They share one base class."""

_REASON = 160  # characters of a library's message that are told


class DgcPoseError(Exception):
    """Base of every error that dgc-pose raises; its message is one line, for people."""


class InputError(DgcPoseError, ValueError):
    """An argument of the wrong shape, range or kind; the message names the argument."""


class ImageError(DgcPoseError):
    """An image file that is missing, empty, corrupt or too large; the message holds the path."""


class ImageSizeError(ImageError):
    """An image of more pixels than are read; the message holds the path and both numbers."""


class WeightsError(DgcPoseError):
    """Weights that are missing, unreadable or of another network; the message holds the file."""


# What `requirements-light.txt` leaves out: modules by the name that pip installs them by.
_OPTIONAL = {
    **{name: name for name in ("h5py", "jinja2", "matplotlib", "pycolmap", "scipy", "torch")},
    "mpl_toolkits": "matplotlib",
    "sklearn": "scikit-learn",
}


def missing_package(failure: ModuleNotFoundError) -> str | None:
    """What a person is told of an import that failed; None if the module is never absent."""
    name = _OPTIONAL.get((failure.name or "").split(".")[0])
    if name is None:
        return None
    return f"this needs {name}, which is not installed: pip install {name}"


def reason(failure: BaseException) -> str:
    """The first line of a library's message, shortened; the name of its class if it says little."""
    lines = str(failure).strip().splitlines()
    text = lines[0].strip() if lines else ""
    if not any(character.isalpha() for character in text):
        text = f"{type(failure).__name__} {text}".strip()
    return shortened(text)


def shortened(text: str) -> str:
    """A text for a message: its middle is left out if it is long."""
    half = _REASON // 2
    return text if len(text) <= _REASON else f"{text[:half]} ... {text[5 - half :]}"
