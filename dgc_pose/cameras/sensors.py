"""The widths of cameras' sensors, from the table that is part of COLMAP."""

from functools import lru_cache

import PIL.Image
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.files.outputs import scratch_folder
from dgc_pose.images.exif import EXIF_DIRECTORY, MAKE, MODEL
from dgc_pose.system.stderr import quiet

_FOCAL_LENGTH = 37386  # a tag of EXIF
_BLANK_WIDTH = 1000  # of the image that COLMAP reads, pixels


@lru_cache(maxsize=256)
def sensor_width_mm(make: str, model: str) -> float | None:
    """The longer side of a camera's sensor, millimetres, by the names in its EXIF data.

    None if the table has no such camera.
    """
    if not (make and model):
        return None
    from dgc_pose.system.colmap_library import pycolmap

    # The table itself is out of reach: COLMAP gives the focal length in pixels of an image file
    # whose lens has 1 mm. Of a photograph it would decode all pixels, prefer the focal length on
    # 35 mm film without its deviation, and not read HEIC.
    exif = PIL.Image.Exif()
    exif[MAKE], exif[MODEL] = make, model
    exif.get_ifd(EXIF_DIRECTORY)[_FOCAL_LENGTH] = IFDRational(1, 1)
    with scratch_folder() as folder:
        path = folder / "blank.jpg"
        PIL.Image.new("L", (_BLANK_WIDTH, 8)).save(path, exif=exif)
        with quiet():
            camera = pycolmap.infer_camera_from_image(path)
    return _BLANK_WIDTH / camera.focal_length if camera.has_prior_focal_length else None
