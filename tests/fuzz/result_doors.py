"""Doors of what dgc-pose itself has written, and of what a page sends: a stranger may have changed
it. Batches with their HDF5 files, collections of `fit-probability`, models, requests."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from fuzz import mutators
from fuzz.door import Door

from dgc_pose.batch.matches_file import PairMatches, write_matches
from dgc_pose.batch.plan import Plan, write_plan
from dgc_pose.batch.rows import BAD_INPUT, PairRow, row_data, unmatched_row
from dgc_pose.batch.run import read_batch
from dgc_pose.batch.store import PartStore, read_part
from dgc_pose.batch.work import Matched
from dgc_pose.benchmarks.probability.collection import read_collection, read_engine
from dgc_pose.benchmarks.probability.plan import Source, read_plan
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.colmap.export import pair_geometries
from dgc_pose.estimation.probability import FEATURES, FORMAT, models_of
from dgc_pose.files.inputs import read_text
from dgc_pose.serve.cameras import CameraRequest, command, python_text
from dgc_pose.serve.store import StoredImage

_SOURCE = Source("scene", part="fit", kind="list")


def batch_plan(folder: Path, names: tuple[str, ...] = ("a.png", "b.png", "c.png")) -> Plan:
    """Three images, one of them bad, and two pairs."""
    K = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])
    cameras = {
        names[0]: Camera(K, (10, 8), guessed_focal=True),
        names[1]: Camera(K, (10, 8), Distortion("OPENCV", (0.1, 0.0, 0.0, 0.0))),
    }
    return Plan(
        folder,
        cameras,
        {names[2]: "too small"},
        {name: (100, 10**18) for name in names},
        names,
        np.array([[0, 1], [1, 2]]),
        {"format": "jsonl", "runtime": "auto"},
    )


def make_batch(folder: Path, names: tuple[str, ...] = ("a.png", "b.png", "c.png")) -> None:
    """A finished batch in `folder`: three images, a pose, a bad pair."""
    plan = batch_plan(folder, names)
    rows = [_row(names[0], names[1]), unmatched_row(names[1:], BAD_INPUT, "too small")]
    write_plan(folder, plan)
    store = PartStore(folder, plan)
    store.add(Matched((0, 1), rows, [_matches(8), _matches(0)], {names[2]: "too small"}))
    bad = store.assemble()
    store.close()
    summary = {"images": 3, "bad_images": bad, "guessed_focal": 1, "pairs": 2, "poses": 1}
    summary |= {
        "by_status": {"ok": 1, "bad_input": 1},
        "matched_now": 2,
        "seconds": 0.5,
    }
    (folder / "summary.json").write_text(json.dumps(summary))


def _row(name1: str, name2: str) -> PairRow:
    known = row_data(unmatched_row((name1, name2), BAD_INPUT, "a pose"))
    known |= {"status": "ok", "success": True, "R": (1, 0, 0, 0, 1, 0, 0, 0, 1), "t": (1, 0, 0)}
    return PairRow(**known | {"num_matches": 8, "num_inliers": 8, "error_px": 0.5})


def _matches(count: int) -> PairMatches:
    points = np.random.default_rng(count).uniform(0, 7, (count, 2)).astype(np.float32)
    scores = np.ones(count, np.float32)
    return PairMatches(points, points + 1, scores, np.ones(count, bool))


def _make_batch_folder(folder: Path) -> None:
    make_batch(folder)


def _read_batch_folder(folder: Path, path: Path) -> object:
    return pair_geometries(read_batch(folder))


def _make_part(folder: Path) -> None:
    import h5py

    rows = [_row("a.png", "b.png")]
    states = {name: [100, 10**18] for name in ("a.png", "b.png")}
    data = {"rows": {"0": row_data(rows[0])}, "bad": {}, "states": states}
    with h5py.File(folder / "000000000.h5", "w") as file:
        file["indices"] = np.array([0])
        file["rows"] = np.frombuffer(json.dumps(data).encode(), dtype=np.uint8)
        write_matches(file.create_group("pairs/0"), _matches(8))


def _make_collection(folder: Path) -> None:
    engine = {"name": "sift", "fingerprint": None}
    own = folder / "matches" / "sift"
    (own / "scene").mkdir(parents=True)
    (own / "engine.json").write_text(json.dumps(engine))
    points = np.random.default_rng(0).uniform(0, 9, (6, 2)).astype(np.float32)
    arrays = {"scene": "scene", "R": np.eye(3), "t": np.array([1.0, 0, 0])}
    for number in (1, 2):
        arrays |= {f"K{number}": np.diag([9.0, 9, 1]), f"size{number}": (10, 8)}
    for prefix in ("", "map_"):
        arrays |= {f"{prefix}points1": points, f"{prefix}points2": points}
        arrays |= {f"{prefix}confidence": np.ones(6, np.float32), f"{prefix}error_px": 1.0}
        arrays |= {f"{prefix}key_points": True}
    np.savez_compressed(own / "scene" / "0000.npz", **arrays)
    parts = [("x", "fit"), ("z", "report")]
    plan = [{"name": name, "part": part, "kind": "list", "path": "a"} for name, part in parts]
    (folder / "plan.json").write_text(json.dumps(plan))


def _read_collection(folder: Path, path: Path) -> object:
    if path.name == "plan.json":
        return read_plan(path)
    return read_engine(folder, "sift"), list(read_collection(folder, "sift", [_SOURCE]))


def _make_models(folder: Path) -> None:
    part = {"slope": -0.3, "intercept": 0.5}
    weights = {name: 0.5 for name in FEATURES}
    model = {"weights": weights, "intercept": 1.0, "reference": weights}
    model |= {"rotation_error": part, "translation_error": part}
    data = {"format": FORMAT, "models": {"network": model}}
    (folder / "probability.json").write_text(json.dumps(data))


def _make_requests(folder: Path) -> None:
    (folder / "k.json").write_text(json.dumps({"kind": "k", "k1": "9,9,4,3", "k2": ""}))
    opencv = "OPENCV,10,8,9,9,5,4,0.1,0,0,0"
    (folder / "model.json").write_text(json.dumps({"kind": "k", "k1": opencv, "k2": opencv}))
    (folder / "fov.json").write_text(json.dumps({"kind": "fov", "fov": 60}))


def _read_request(folder: Path, path: Path) -> object:
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None  # the server refuses it itself
    request = CameraRequest.of(data)
    images = [StoredImage(folder / name, name, (10, 8)) for name in ("one", "--two")]
    cameras = request.resolve(*images)
    flags = request.flags(cameras)
    names = ("one", "--two")
    return command(names, flags, []), python_text(names, request.python(cameras, names), "")


RESULT_DOORS = (
    Door(
        "batch folders",
        _make_batch_folder,
        _read_batch_folder,
        {".json": mutators.JSON, ".jsonl": mutators.JSON, ".h5": mutators.BYTES},
    ),
    Door(
        "batch parts",
        _make_part,
        lambda _, path: read_part(path, batch_plan(path.parent)),
        {".h5": mutators.BYTES},
        0.5,
    ),
    Door(
        "collections",
        _make_collection,
        _read_collection,
        {".json": mutators.JSON, ".npz": mutators.ZIP},
    ),
    Door(
        "models",
        _make_models,
        lambda _, path: models_of(read_text(path), str(path)),
        {".json": mutators.JSON},
        0.5,
    ),
    Door("requests", _make_requests, _read_request, {".json": mutators.JSON}),
)
