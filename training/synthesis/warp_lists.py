"""The DGC-Net authors' lists of warps, which define their training and test pairs.

A list is a CSV of `fname,aff/tps/homo,t1,...,t18`, zero-padded. By the second column:

- 0, affine: t1 to t6 are the 2x3 matrix, row by row; it maps points of the target view to points
  of the source view, normalised to -1 and +1 at the centres of the outermost pixels.
- 1, thin-plate spline: t1 to t9 the x and t10 to t18 the y of the points that the control points
  of a 3x3 grid map to, x = -1 -1 -1 0 0 0 1 1 1 and y = -1 0 1 repeated; in the same coordinates.
- 2, homography: t1 to t9, row by row, from source to target in pixels of a 768x576 photograph.

Views of 0 and 1 are the middle 9/16 of a 640x480 photograph, mirrored beyond its edges; those of 2
the 240x240 pixels from (264, 168) of a 768x576 photograph, its homographic image black beyond its
edges.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.images.image import load_image
from dgc_pose.network.spline import TPS_KNOTS, thin_plate_spline
from dgc_pose.training.synthesis.map_pairs import MapPairs, point_grid
from dgc_pose.training.synthesis.photos import resized_planes
from dgc_pose.training.synthesis.warps import apply_homography

WarpKind = Literal["affine", "tps", "homography"]
_KINDS: tuple[WarpKind, ...] = get_args(WarpKind)  # in the order of their numbers in a list
_PARAMETERS = 18

_BENT_SIZE = (640, 480)  # width, height of the photograph that affine and spline views are cut from
_VIEW = 9 / 16  # of its width and height
_PLANE_SIZE = (768, 576)  # of the photograph that homography views are cut from
_CROP = (264, 168)  # left, top; pixels
_SIDE = 240  # pixels of a view


@dataclass(frozen=True)
class WarpRow:
    """One pair of a list."""

    file: str  # the photograph, below the folder of images
    kind: WarpKind
    parameters: tuple[float, ...]  # 18, as in the list


def read_warps(path: str | Path) -> list[WarpRow]:
    """The rows of a list, in order.

    Raises InputError, with the path and the line, for a malformed list; OSError.
    """
    text = io.StringIO(read_text(path, "a list of warps"), newline="")
    with read_as("a list of warps", path):
        reader = csv.reader(text)
        header = next(reader, [])
        if [name.strip() for name in header[:2]] != ["fname", "aff/tps/homo"]:
            raise InputError(f"{path}:1: expected the columns fname,aff/tps/homo,t1,...")
        rows = [_parse(row, f"{path}:{reader.line_num}") for row in reader if row]
    if not rows:
        raise InputError(f"{path}: the list has no rows")
    return rows


def list_pairs(rows: Sequence[WarpRow], root: str | Path) -> MapPairs:
    """The pairs of rows of one kind, 240 pixels a side, of photographs below `root`.

    `valid` is the authors': both coordinates of the true point in [-1, 1]. Raises ImageError if a
    photograph cannot be read.
    """
    kind = rows[0].kind
    photo_size = _PLANE_SIZE if kind == "homography" else _BENT_SIZE
    files = [load_image(Path(root) / row.file).pixels for row in rows]
    photos = torch.stack([resized_planes(pixels, photo_size) for pixels in files]).float() / 255
    parameters = torch.tensor([row.parameters for row in rows], dtype=torch.float64)
    if kind == "homography":
        image1, image2, truth = _plane_pairs(parameters[:, :9].view(-1, 3, 3), photos)
    else:
        image1, image2, truth = _bent_pairs(kind, parameters.float(), photos)
    valid = ((truth >= 0) & (truth <= _SIDE - 1)).all(-1)
    return MapPairs(image1, image2, truth, valid)


def _parse(fields: list[str], where: str) -> WarpRow:
    if len(fields) != 2 + _PARAMETERS:
        raise InputError(f"{where}: expected {2 + _PARAMETERS} fields, found {len(fields)}")
    try:
        number = float(fields[1])
        parameters = tuple(float(field) for field in fields[2:])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    if number not in (0, 1, 2):
        raise InputError(f"{where}: the kind must be 0, 1 or 2, not {fields[1]}")
    if not fields[0] or not np.isfinite(parameters).all():
        raise InputError(f"{where}: a file name and finite numbers are needed")
    kind = _KINDS[int(number)]
    if kind == "homography" and abs(np.linalg.det(np.reshape(parameters[:9], (3, 3)))) < 1e-12:
        raise InputError(f"{where}: the homography cannot be inverted")
    return WarpRow(fields[0], kind, parameters)


def _bent_pairs(kind: WarpKind, values: Tensor, photos: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Images of both views and the map (B, S, S, 2) in pixels, of affine or spline rows (B, 18)."""
    grid = point_grid(torch.linspace(-1, 1, _SIDE)).expand(len(photos), -1, -1)
    if kind == "affine":
        affine = torch.eye(3).repeat(len(photos), 1, 1)
        affine[:, :2] = values[:, :6].view(-1, 2, 3)
        source = apply_homography(affine, grid)
    else:
        source = thin_plate_spline(TPS_KNOTS, values.view(-1, 2, 9).transpose(1, 2))(grid)
    side = torch.tensor(_BENT_SIZE)

    def view(points: Tensor) -> Tensor:
        # -1 and +1 are the outermost pixels of the photograph mirrored to twice its size.
        pixels = (points * _VIEW / 2 + 1) * (2 * side - 1) / 2 - side / 2
        normalised = ((2 * pixels + 1) / side - 1).view(-1, _SIDE, _SIDE, 2)
        return F.grid_sample(photos, normalised, padding_mode="reflection", align_corners=False)

    pixels = ((source + 1) * (_SIDE - 1) / 2).view(-1, _SIDE, _SIDE, 2)
    return view(grid), view(source), pixels


def _plane_pairs(H: Tensor, photos: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Images of both views and the map (B, S, S, 2) in pixels, of homographies (B, 3, 3)."""
    crop, side = torch.tensor(_CROP), torch.tensor(_PLANE_SIZE)
    grid = (point_grid(torch.arange(_SIDE)) + crop).float().expand(len(photos), -1, -1)
    inverse = torch.linalg.inv(H)
    middle = torch.tensor([(side - 1) / 2 for side in _PLANE_SIZE] + [1.0], dtype=torch.float64)
    inverse = inverse / (inverse[:, 2] @ middle)[:, None, None]  # depths positive in the middle
    source = apply_homography(inverse.float(), grid)

    def view(points: Tensor) -> Tensor:
        normalised = ((2 * points + 1) / side - 1).view(-1, _SIDE, _SIDE, 2)
        return F.grid_sample(photos, normalised, align_corners=False)

    return view(grid), view(source), (source - crop).view(-1, _SIDE, _SIDE, 2)
