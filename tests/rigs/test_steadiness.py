"""Frames of a camera in one position, and in several."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_scene import texture

from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.rigs.steadiness import steady_frames

SIZE = (420, 280)


def frames_at(*motions: tuple[float, float, float]) -> dict[Path, Image]:
    """Frames of a camera, noisy and with a person in every other one. motions: of the picture, x
    and y in pixels, and a roll in degrees."""
    scene = np.stack([texture(SIZE, seed) for seed in range(3)], -1)
    rng = np.random.default_rng(0)
    frames = {}
    for number, (x, y, roll) in enumerate(motions):
        motion = cv2.getRotationMatrix2D((SIZE[0] / 2, SIZE[1] / 2), roll, 1.0)
        motion[:, 2] += x, y
        pixels = cv2.warpAffine(scene, motion, SIZE, borderMode=cv2.BORDER_REFLECT)
        if number % 2:
            pixels[105:, 28 * number : 28 * number + 84] = 30 * number
        noisy = (pixels + rng.normal(0, 4, pixels.shape)).clip(0, 255).astype(np.uint8)
        frames[Path(f"{number}.png")] = Image(noisy)
    return frames


STILL = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("motion", [(0.14, 0, 0), (0, 0.07, 0.01)])
def test_a_camera_that_stands_still_keeps_all_frames(motion: tuple[float, float, float]) -> None:
    """Also one of a dark night, whose position cannot be told."""
    frames = frames_at(STILL, motion, STILL, motion, STILL)
    frames[Path("night.png")] = Image(np.zeros((*SIZE[::-1], 3), np.uint8))
    assert steady_frames(frames) == (frames, "")


def test_a_board_that_fills_most_of_the_picture_is_not_the_camera() -> None:
    frames = frames_at(STILL, STILL, STILL, STILL, STILL)
    board = texture((280, 238), 7)[..., None]
    for number, frame in enumerate(frames.values()):
        frame.pixels[:238, 14 + 8 * number : 294 + 8 * number] = board
    assert steady_frames(frames) == (frames, "")


@pytest.mark.parametrize(
    ("motion", "share"),
    [((2.1, 0, 0), 0.5), ((0, -21.0, 0), 5), ((0, 0, 1.0), 0.525), ((105.0, 0, 0), 25)],
)
def test_the_frames_after_a_motion_are_left_out(
    motion: tuple[float, float, float], share: float
) -> None:
    """The sentence has the share of the longer side."""
    frames = frames_at(*[STILL] * 3, *[motion] * 2)
    paths = [*frames]
    kept, told = steady_frames(frames)
    assert [*kept] == paths[:3]
    words = told.split()
    assert float(words[4]) == pytest.approx(share, rel=0.1)
    assert words[:4] == "the picture moves by".split()
    assert told.endswith(": the 3 of 5 frames in one position are used")


def test_the_frames_before_a_motion_are_left_out_if_they_are_fewer() -> None:
    frames = frames_at(*[STILL] * 2, *[(2.1, 0.0, 0.0)] * 3)
    kept, _ = steady_frames(frames)
    assert [*kept] == [*frames][2:]


def test_a_camera_in_several_positions_is_refused() -> None:
    """Half of the frames are not most of them."""
    for motions in ([STILL, (8.4, 0, 0)] * 2, [(2.8 * n, 0, 0) for n in range(4)]):
        with pytest.raises(
            InputError, match=r"^the picture moves by 2 % of its side between 0\.png"
        ):
            steady_frames(frames_at(*motions))
