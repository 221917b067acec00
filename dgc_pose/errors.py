"""The errors that dgc-pose raises. They share one base class."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

_REASON = 160  # most characters of a library's message in an error


class ArgumentName(str):
    """The name of an argument or a field in a message. A command replaces it by the flag."""


class DgcPoseError(Exception):
    """Base of every error that dgc-pose raises; its message is one line, for people.

    args: the parts of the message, which blanks join. A part that is a Path is the file that the
    error is about.
    """

    @property
    def path(self) -> Path | None:
        """The file that the error is about; None if the message names no file."""
        return next((part for part in self.args if isinstance(part, Path)), None)

    def __str__(self) -> str:
        return " ".join(map(str, self.args))


class InputError(DgcPoseError, ValueError):
    """An argument of the wrong shape, range or kind; the message names the argument."""


class ImageError(DgcPoseError):
    """An image file that is missing, empty, corrupt or too large; the message holds the path."""


class WeightsError(DgcPoseError):
    """Weights that are missing, unreadable or of another network; the message holds the file."""


# For each extra of setup.cfg: its modules, and the package that pip installs for each.
EXTRAS = {
    "fit": {"scipy": "scipy", "sklearn": "scikit-learn"},
    "heic": {"pillow_heif": "pillow-heif"},
    "ray": {"ray": "ray"},
    "serve": {"starlette": "starlette", "uvicorn": "uvicorn"},
    "torch": {"torch": "torch"},
}

# Distributions of this repository that no extra has: each installs from its folder.
FOLDERS = {"lightglue": {"dgc_pose_lightglue": "dgc_pose_lightglue"}}


def is_installed(module: str) -> bool:
    """Whether a module is installed; does not import it."""
    return find_spec(module) is not None


def require(needs: Mapping[str, str]) -> None:
    """Raise InputError, with the command that installs it, if one of these extras or folders is
    missing.

    needs: by feature, such as an option, the name of the extra or folder that it needs.
    """
    for what, extra in needs.items():
        if message := missing(what, extra):
            raise InputError(message)


def missing_package(failure: ModuleNotFoundError, what: str = "this") -> str | None:
    """The message for an import that failed; None if no missing extra contains the module.

    what: the command or option that needed it.
    """
    module = (failure.name or "").split(".")[0]
    extra = next((extra for extra, modules in EXTRAS.items() if module in modules), None)
    return None if extra is None else missing(what, extra)


def missing(what: str, extra: str) -> str | None:
    """The message that `what` needs an extra or folder, with the command that installs it; None if
    it is installed."""
    modules = EXTRAS.get(extra) or FOLDERS[extra]
    lacks = sorted({name for module, name in modules.items() if not is_installed(module)})
    if not lacks:
        return None
    names = " and ".join(lacks)
    verb = "is" if len(lacks) == 1 else "are"
    source = f"./{extra}" if extra in FOLDERS else f"'.[{extra}]'"
    return f"{what} needs {names}, which {verb} not installed: pip install {source}"


def reason(failure: BaseException) -> str:
    """The first line of a library's message, shortened; with its class if it has no letters."""
    text = str(failure).strip().partition("\n")[0].strip()
    if isinstance(failure, KeyError) and failure.args:
        text = f"no {text}"
    if not any(character.isalpha() for character in text):
        text = f"{type(failure).__name__} {text}".strip()
    return shortened(text)


def printable(text: str) -> str:
    """A text, such as the name of a file, as one line without control characters."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


def shortened(text: str, most: int = _REASON) -> str:
    """A text of at most `most` characters: a longer one loses its middle."""
    half = most // 2
    return text if len(text) <= most else f"{text[:half]} ... {text[5 - half :]}"
