"""The weights inside the package: each loads, is in half precision, and has a card that fits it."""

import hashlib
import re
from importlib import resources

import pytest
import torch
from safetensors import safe_open

from dgc_pose.network.config import PRESETS
from dgc_pose.network.weights import load_network, shipped


@pytest.mark.parametrize("name", shipped())
def test_each_loads_and_has_a_card(name):
    folder = resources.files("dgc_pose") / "weights"
    net = load_network(name)
    assert name in PRESETS and net.config == PRESETS[name]
    with resources.as_file(folder / f"{name}.safetensors") as path:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(path, "pt") as file:
            assert {file.get_tensor(key).dtype for key in file.keys()} == {torch.float16}
    card = (folder / f"{name}.md").read_text(encoding="utf-8")
    assert digest in card
    for entry in ("Preset", "Data", "Steps", "Hardware", "Seed", "Command", "Scores"):
        assert re.search(rf"^\| {entry} \|", card, re.MULTILINE), entry
