"""The picture of the page in the documentation, as a browser shows it:

python tests/page_picture.py docs/serve.png
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from chromium import chromium_page, find_chromium

DONE = "document.querySelector('#progress').textContent.startsWith('done')"
WIDTH, TALLEST = 1240, 4000  # pixels


def main(out: Path, *options: str) -> None:
    """The bundled pair's pose with the pointer on image 1; options: further ones of `serve`."""
    executable = find_chromium()
    if executable is None:
        raise SystemExit("no Chromium on this machine: install it, or name one in $CHROMIUM")
    command = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser", *options]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        with chromium_page(executable) as page:
            page.own += (url.split("?")[0], "blob:")
            page.resize(WIDTH, TALLEST)
            page.open(url)
            page.click("#example")
            page.wait(DONE)
            page.resize(WIDTH, int(page.evaluate("document.body.scrollHeight")) + 8)
            page.evaluate("scrollTo(0, 0)")
            page.hover("#view", (0.27, 0.55))
            page.screenshot(out)
    finally:
        server.terminate()
        server.communicate(timeout=60)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
