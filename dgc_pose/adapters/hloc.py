"""hloc's files: `features.h5`, `matches.h5` and `pairs.txt`, which its reconstruction reads.

features.h5 has `<image>/keypoints` (float32, (0, 0) the centre of the first pixel) and
`<image>/scores`; matches.h5 has `name0/name1` ("/" inside a name becomes "-") with `matches0`
(int32, -1 for none) and `matching_scores0` (float16); pairs.txt has two names a line.
"""

from pathlib import Path

import numpy as np

from dgc_pose.batch.result import group_name, new_file
from dgc_pose.colmap.shared import SharedMatches
from dgc_pose.errors import InputError, reason
from dgc_pose.files.outputs import replaced, save_text


def write_hloc(folder: Path, shared: SharedMatches) -> None:
    """Write the three files of shared key points, over what is there.

    Raises InputError for a name with a blank, which a pairs file cannot hold, and for two names
    that would be one in HDF5.
    """
    for names in shared.pairs:
        if any(len(name.split()) != 1 for name in names):
            raise InputError(f"hloc's pairs file cannot hold the names {names}: no blanks")
    folder.mkdir(parents=True, exist_ok=True)
    with (
        replaced(folder / "features.h5") as features,
        replaced(folder / "matches.h5") as matches,
        replaced(folder / "pairs.txt") as pairs,
    ):
        try:
            with new_file(features) as file:
                for name, points in shared.key_points.items():
                    group = file.create_group(name)
                    group.create_dataset("keypoints", data=points.astype(np.float32))
                    group.create_dataset("scores", data=np.ones(len(points), np.float32))
            with new_file(matches) as file:
                for (name0, name1), index in shared.pairs.items():
                    group = file.create_group(group_name(name0, name1))
                    matches0 = np.full(len(shared.key_points[name0]), -1, dtype=np.int32)
                    matches0[index[:, 0]] = index[:, 1]
                    group.create_dataset("matches0", data=matches0)
                    scores = (matches0 >= 0).astype(np.float16)
                    group.create_dataset("matching_scores0", data=scores)
        except ValueError as error:  # of h5py
            raise InputError(f"hloc's files cannot hold these names: {reason(error)}") from None
        save_text(pairs, "".join(f"{name0} {name1}\n" for name0, name1 in shared.pairs))
