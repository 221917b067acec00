"""Draw docs/serve.png and docs/model.png: the page and a model's page, in headless Chromium.

    make screenshots

The page shows the bundled photographs, the model a drawn room seen from seven places.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from figures import ROOT, output, save_picture
from PIL import Image

sys.path.insert(0, str(ROOT / "tests"))

from chromium import Page, chromium_page, find_chromium  # noqa: E402
from worlds import K, K_text, draw_textures, render_views, write_views  # noqa: E402

SIZE = (960, 720)  # of the room's views, pixels
VIEWS = 7
DONE = "document.querySelector('#progress').textContent.startsWith('done')"


def draw_page(page: Page, picture: Path) -> None:
    words = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = next(word for line in server.stdout for word in line.split() if "://" in word)
            page.open_anew(address)
            page.click("#example")
            page.wait(DONE)
            page.screenshot(picture, 780)
        finally:
            server.terminate()


def draw_model(page: Page, picture: Path, folder: Path) -> None:
    textures = draw_textures()
    for plane, photograph in ((0, "photographs/image1.jpg"), (2, "rendered/image1.jpg")):
        pixels = Image.open(ROOT / "dgc_pose" / "data" / photograph).convert("RGB")
        textures[plane] = np.asarray(pixels.resize(textures[plane].shape[1::-1]), np.float32)
    scaled = np.diag([4.0, 4.0, 1.0]) @ K
    write_views(folder / "room", render_views(VIEWS, textures=textures, K=scaled, size=SIZE))
    output(f"dgc-pose reconstruct {folder}/room --K {K_text(scaled)} --out {folder}/model")
    page.open_anew((folder / "model" / "model.html").as_uri())
    page.screenshot(picture, 1100, 640)


def main() -> None:
    executable = find_chromium()
    if executable is None:
        sys.exit("no Chromium: install it, or name one in $CHROMIUM")
    with tempfile.TemporaryDirectory() as name, chromium_page(executable) as page:
        pictures = [Path(name, picture) for picture in ("serve.png", "model.png")]
        draw_page(page, pictures[0])
        draw_model(page, pictures[1], Path(name))
        for picture in pictures:
            save_picture(Image.open(picture), picture.name)


if __name__ == "__main__":
    main()
