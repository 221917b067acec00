"""Matches of another program: a COLMAP database, hloc's features and matches, or a folder of .npz.

A source is a file of this package with a class derived from `GivenMatches`.
"""

from pathlib import Path

from dgc_pose.batch.given.database import read_database
from dgc_pose.batch.given.hloc import read_hloc
from dgc_pose.batch.given.matches import GivenMatches
from dgc_pose.batch.given.npz import read_npz


def read_given(path: Path) -> GivenMatches:
    """The images and pairs of a source: a COLMAP database, a folder with hloc's files of features
    and of matches, or a folder of .npz.

    An .npz has `points1` and `points2` (N, 2), and optionally `confidence` (N,), `error_px` and
    `key_points`, by default False. `image1` and `image2` are the names of its images; without them
    its own name is NAME1_NAME2.npz. A damaged one with such a name is a pair, whose `read` raises.

    Raises InputError, with the path, if the source is none of these or has no matches; OSError if
    it cannot be read.
    """
    if not path.is_dir():
        return read_database(path)
    if any(path.glob("*.h5")):
        return read_hloc(path)
    return read_npz(path)
