"""What a stranger's file may not do: run code, lead elsewhere, take memory or time without end."""

import io
import os
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from fuzz.readers import make_batch

from dgc_pose.batch.result import read_batch
from dgc_pose.cameras.formats.colmap import read_database
from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.system.arrays import ARRAY_BYTES, read_array, read_arrays
from dgc_pose.training.run import save_weights


class _Code:
    def __reduce__(self):
        return (os.mkdir, ("executed",))


def test_no_pickle_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"a": _Code()}, "w.pth")
    np.save("a.npy", np.array([_Code()]), allow_pickle=True)
    np.savez("a.npz", flow=np.array([_Code()], dtype=object))
    for read, name in ((load_network, "w.pth"), (read_array, "a.npy"), (read_arrays, "a.npz")):
        with pytest.raises(DgcPoseError, match=name) as caught:
            read(Path(name))
        assert "weights_only" not in str(caught.value)
    assert not Path("executed").exists()


def _packed(path):
    """Its size once unpacked has no bound."""
    stream = io.BytesIO()
    torch.save({"a": torch.zeros(10)}, stream)
    with zipfile.ZipFile(stream) as old, zipfile.ZipFile(path, "w", 8) as new:
        for info in old.infolist():
            new.writestr(info.filename, old.read(info))


def test_foreign_weights_are_refused(tmp_path):
    net = DGCNet(preset("dgcm-lite0"))
    next(net.parameters()).data.fill_(np.nan)
    save_weights(net, tmp_path / "w.safetensors")
    with pytest.raises(WeightsError, match="w.safetensors.*not finite"):
        load_network(tmp_path / "w.safetensors")
    _packed(tmp_path / "w.pth")
    with pytest.raises(WeightsError, match="w.pth.*compressed"):
        load_network(tmp_path / "w.pth")


def test_an_array_that_claims_too_much_takes_no_memory(tmp_path):
    header = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (2**40, 2**40)}
    np.lib.format.write_array_header_1_0(header, about)
    (tmp_path / "a.npy").write_bytes(header.getvalue() + b"0" * 80)
    with pytest.raises(InputError, match="cannot reshape"):
        read_array(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("flow.npy", header.getvalue())
    data = bytearray((tmp_path / "a.npz").read_bytes())
    place = data.rindex(b"PK\x01\x02") + 24  # the unpacked size in the archive's directory
    data[place : place + 4] = (ARRAY_BYTES + 1).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(InputError, match="too large"):
        read_arrays(tmp_path / "a.npz")


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"


def test_a_database_that_computes_is_refused(tmp_path):
    """COLMAP's, and the store of a batch."""
    pycolmap.Database.open(tmp_path / "a.db").close()
    make_batch(tmp_path)
    for name, table in (("a.db", "matches"), ("batch/batch.db", "result")):
        with closing(sqlite3.connect(tmp_path / name)) as database:
            database.executescript(f"DROP TABLE {table}; CREATE VIEW {table} AS {ENDLESS}")
    with pytest.raises(
        InputError, match=r"a\.db cannot be read as a COLMAP database .*computes matches"
    ):
        read_database(tmp_path / "a.db")
    with pytest.raises(InputError, match=r"batch\.db cannot be read as the store of a batch"):
        read_batch(tmp_path / "batch")
