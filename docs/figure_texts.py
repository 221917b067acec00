"""A hook of mkdocs: the figures of a notebook get their texts for who cannot see them.

A notebook keeps the text of a figure in the metadata of the cell's output, as Jupyter has it. The
template of nbconvert that mkdocs-jupyter uses leaves it out, and says that there is none.
"""

import html
import json
from pathlib import Path
from typing import Any

_NONE = 'alt="No description has been provided for this image"'


def on_page_content(content: str, *, page: Any, **_: Any) -> str:
    """The page with the texts in the place of those that are missing, in order."""
    path = Path(page.file.abs_src_path)
    if path.suffix == ".ipynb":
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        for output in (output for cell in cells for output in cell.get("outputs", [])):
            if picture := output.get("metadata", {}).get("image/jpeg"):
                content = content.replace(_NONE, f'alt="{html.escape(picture["alt"])}"', 1)
    return content
