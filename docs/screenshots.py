"""Draw docs/serve.png, docs/model.png and docs/rig.png: the page, a model's page and a rig's page,
in headless Chromium.

    make screenshots

The page shows the bundled photographs, the model a drawn room seen from seven places, the rig four
cameras in this room.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from figures import ROOT, output, save_picture
from PIL import Image

sys.path.insert(0, str(ROOT / "tests"))

from chromium import Page, chromium_page, find_chromium  # noqa: E402
from worlds import (  # noqa: E402
    K,
    K_text,
    draw_textures,
    look_at,
    render,
    render_views,
    write_views,
)

SIZE = (960, 720)  # of the room's views, pixels
LARGE_K = np.diag([4.0, 4.0, 1.0]) @ K  # of these views
VIEWS = 7
WALK = 14
FIXED = {  # the centre of each camera of the rig, the point it looks at, and its zoom
    "desk": ((-1.7, 0.7, 1.0), (0.9, 0.4, 5.5), 1.0),
    "door": ((2.7, -0.9, 1.3), (-0.8, 0.5, 5.0), 1.0),
    "shelf": ((1.0, -1.3, 2.4), (-1.2, 0.7, 5.5), 0.8),
    "window": ((-0.3, -1.1, -0.6), (0.1, 0.4, 4.8), 1.3),
}
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


def room_textures() -> list[np.ndarray]:
    """Of the room: two walls have a photograph, all else pale colours."""
    textures = [0.75 * drawn.mean(2, keepdims=True) + 0.25 * drawn for drawn in draw_textures()]
    for plane, photograph in ((0, "photographs/image1.jpg"), (2, "rendered/image1.jpg")):
        pixels = Image.open(ROOT / "dgc_pose" / "data" / photograph).convert("RGB")
        textures[plane] = np.asarray(pixels.resize(textures[plane].shape[1::-1]), np.float32)
    return textures


def draw_model(page: Page, picture: Path, folder: Path) -> None:
    views = render_views(VIEWS, textures=room_textures(), K=LARGE_K, size=SIZE)
    write_views(folder / "room", views)
    output(f"dgc-pose reconstruct {folder}/room --K {K_text(LARGE_K)} --out {folder}/model")
    open_model(page, folder / "model")
    page.screenshot(picture, 1100, 640)


def draw_rig(page: Page, picture: Path, folder: Path) -> None:
    textures = room_textures()
    write_views(folder / "walk", render_views(WALK, textures=textures, K=LARGE_K, size=SIZE))
    (folder / "cameras").mkdir()
    for name, (centre, target, zoom) in FIXED.items():
        R = look_at(np.array(centre), np.array(target))
        own_K = LARGE_K * [[zoom], [zoom], [1]]
        own_K[:2, 2] = LARGE_K[:2, 2]
        pixels, _ = render(R, np.array(centre), textures, own_K, SIZE)
        cv2.imwrite(str(folder / "cameras" / f"{name}.png"), pixels[:, :, ::-1])
    output(f"dgc-pose rig {folder}/cameras --walk {folder}/walk --out {folder}/rig")
    open_model(page, folder / "rig")
    page.screenshot(picture, 1100, 640)


def open_model(page: Page, folder: Path) -> None:
    """Show model.html of a folder, with all photographs."""
    page.open_anew((folder / "model.html").as_uri())
    page.wait("document.querySelector('canvas').children.length > 0")


def main() -> None:
    executable = find_chromium()
    if executable is None:
        sys.exit("no Chromium: install it, or name one in $CHROMIUM")
    with tempfile.TemporaryDirectory() as name, chromium_page(executable) as page:
        pictures = [Path(name, picture) for picture in ("serve.png", "model.png", "rig.png")]
        draw_page(page, pictures[0])
        draw_model(page, pictures[1], Path(name))
        draw_rig(page, pictures[2], Path(name))
        for picture in pictures:
            save_picture(Image.open(picture), picture.name)


if __name__ == "__main__":
    main()
