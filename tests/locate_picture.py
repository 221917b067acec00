"""Draw locate.png and model.png of docs/: `cd tests; ../.venv/bin/python locate_picture.py`."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
import torch
from chromium import chromium_page, find_chromium
from command_line import run
from PIL import Image
from textures import drawn_photos

from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.training.draw import Draw
from dgc_pose.training.map_pairs import image_arrays
from dgc_pose.training.room_pairs import RoomOptions, random_rooms, render
from dgc_pose.training.views import Cameras

SEED, SIZE, PHOTO = 5, (800, 600), 3
K = torch.tensor([[700.0, 700, 400, 300]])


def _camera(angle: float, height: float, look: torch.Tensor) -> Cameras:
    away = torch.tensor([[1.5 * np.sin(angle), height - 0.35, -1.5 * np.cos(angle)]])
    return Cameras.looking(K, look + away.float(), look, torch.zeros(1))


def main() -> None:
    photos = drawn_photos(8, 512)
    options = RoomOptions(boxes=6, ellipsoids=2, spans=((0.9, 1.6), (0.5, 0.9)))
    rooms, look = random_rooms(1, photos, Draw("cpu", SEED), options)
    angles = np.radians(np.linspace(-42, 42, 8))
    cameras = [_camera(angle, 0.12 * np.sin(3 * i), look) for i, angle in enumerate(angles)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        lines = ["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy"]
        for i, camera in enumerate(cameras):
            pixels = image_arrays(render(rooms, camera, SIZE[::-1], photos.bank)[0])[0]
            path = folder / ("new.png" if i == PHOTO else f"images/view{i}.png")
            cv2.imwrite(str(path), pixels[..., ::-1])
            R, t = camera.pose[0].double().split(3, 1)
            pose = [*quaternion_wxyz(R.numpy()), *t[:, 0].tolist()]
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
            page.open_anew((folder / "photos" / "model.html").as_uri())
            page.click("[data-from=aslant]")
            page.screenshot(folder / "model.png")
        _save(folder / "model.png")


def _save(path: Path) -> None:
    picture = Image.open(path).convert("RGB").quantize(256)
    picture.save(Path(__file__).parents[1] / "docs" / path.name, optimize=True)


if __name__ == "__main__":
    main()
