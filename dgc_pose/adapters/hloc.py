"""hloc's files, which its reconstruction reads: `features.h5` has `<image>/keypoints` (float32,
(0, 0) the centre of the first pixel) and `scores`; `matches.h5` has `name0/name1` with `matches0`
(int32, -1 for none) and `matching_scores0` (float16); `pairs.txt` has two names a line."""

from pathlib import Path

import h5py
import numpy as np

from dgc_pose.batch.result import group_name
from dgc_pose.colmap.tracking import SharedMatches
from dgc_pose.errors import InputError
from dgc_pose.system.files import save_text, staged


def write_hloc(folder: Path, shared: SharedMatches) -> None:
    """Write the three files of shared key points, over what is there.

    Raises InputError for a name with a blank, which a pairs file cannot hold.
    """
    for names in shared.pairs:
        if any(len(name.split()) != 1 for name in names):
            raise InputError(f"hloc's pairs file cannot hold the names {names}: no blanks")
    folder.mkdir(parents=True, exist_ok=True)
    paths = [str(folder / name) for name in ("features.h5", "matches.h5", "pairs.txt")]
    with staged(*paths) as stage:
        features, matches, pairs = map(stage, paths)
        with h5py.File(features, "w") as file:
            for name, points in shared.key_points.items():
                file[f"{name}/keypoints"] = points.astype(np.float32)
                file[f"{name}/scores"] = np.ones(len(points), np.float32)
        with h5py.File(matches, "w") as file:
            for names, index in shared.pairs.items():
                matches0 = np.full(len(shared.key_points[names[0]]), -1, np.int32)
                matches0[index[:, 0]] = index[:, 1]
                file[f"{group_name(*names)}/matches0"] = matches0
                scores = (matches0 >= 0).astype(np.float16)
                file[f"{group_name(*names)}/matching_scores0"] = scores
        save_text(pairs, "".join(f"{name0} {name1}\n" for name0, name1 in shared.pairs))
