"""Draw locate.png and model.png of docs/: `cd tests; ../.venv/bin/python locate_picture.py`."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
import torch
from chromium import chromium_page, find_chromium
from command_line import run
from PIL import Image
from procedural import procedural_textures

from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, look_at
from dgc_pose.training.synthesis.render.random_scene import random_scene
from dgc_pose.training.synthesis.render.rendered_pairs import Views, as_arrays, render_views

SEED, SIZE, PHOTO = 5, (800, 600), 3
K = torch.tensor([[700.0, 0, 400], [0, 700, 300], [0, 0, 1]]).double()[None]


def _camera(angle: float, height: float) -> Cameras:
    place = [1.5 * np.sin(angle), height - 0.35, -1.5 * np.cos(angle)]
    centre = torch.tensor([place], dtype=torch.float64)
    return Cameras.at(centre, K, look_at(centre, torch.zeros_like(centre)), SIZE)


def main() -> None:
    draw = Draw(torch.Generator().manual_seed(SEED), torch.device("cpu"), torch.float64)
    angles = np.radians(np.linspace(-42, 42, 8))
    cameras = [_camera(angle, 0.12 * np.sin(3 * i)) for i, angle in enumerate(angles)]
    bank = TextureBank.from_photos(procedural_textures(8, 512, seed=SEED))
    options = SceneOptions(boxes=4, ellipsoids=2, quads=2, texture_span=(0.5, 0.9))
    scene = random_scene(draw, cameras[0], cameras[-1], bank.size, bank.count, options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        lines = ["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy"]
        for i, camera in enumerate(cameras):
            pair = as_arrays(render_views(Views(scene, camera, camera), bank, options, scene.light))
            path = folder / ("new.png" if i == PHOTO else f"images/view{i}.png")
            cv2.imwrite(str(path), pair.image1[..., ::-1])
            pose = [*quaternion_wxyz(camera.rotation[0].numpy()), *camera.translation[0].tolist()]
            if i != PHOTO:
                lines.append(",".join(map(str, [path.name, *pose, 700, 700, 400, 300])))
        (folder / "poses.csv").write_text("\n".join(lines))
        model = ("--model", folder / "poses.csv", "--images", folder / "images")
        words = ("--K", "700,700,400,300", "--plot", folder / "locate.png")
        print(run("locate", folder / "new.png", *model, *words).output)
        _save(folder / "locate.png")
        words = ("--K", "700,700,400,300", "--out", folder / "photos")
        print(run("reconstruct", folder / "images", *words).output)
        with chromium_page(find_chromium() or "chromium") as page:
            page.resize(1100, 640)
            page.open((folder / "photos" / "model.html").as_uri())
            page.click("[data-from=aslant]")
            page.screenshot(folder / "model.png")
        _save(folder / "model.png")


def _save(path: Path) -> None:
    picture = Image.open(path).convert("RGB").quantize(256)
    picture.save(Path(__file__).parents[1] / "docs" / path.name, optimize=True)


if __name__ == "__main__":
    main()
