"""EXIF data of a camera, as Pillow writes them."""

from typing import Any

import PIL.Image

FOCAL, FILM, ZOOM, LENS = 0x920A, 0xA405, 0xA404, 0xA434
WIDTH, HEIGHT, PLANE_X, PLANE_Y, PLANE_UNIT = 0xA002, 0xA003, 0xA20E, 0xA20F, 0xA210


def exif_of(tags: dict[int, Any], make: str = "Apple", model: str = "iPhone 13") -> PIL.Image.Exif:
    exif = PIL.Image.Exif()
    exif[271], exif[272] = make, model
    exif.get_ifd(0x8769).update(tags)
    return exif
