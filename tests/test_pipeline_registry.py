"""The table of stages agrees with the stages, and asking them costs nothing."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from minidual.config.loader import load_config
from minidual.gate.canonical import canonical, digest
from minidual.stages.registry import STAGES

ORDER = ("env-check", "plan", "carry", "teleop-record", "train-act", "deploy", "benchmark", "report")
PROFILES = ("smoke", "standard", "gpu")


def test_stages_stand_in_order():
    assert STAGES.names == ORDER
    assert [entry.name for entry in STAGES if entry.closing] == ["report"]
    assert STAGES.upstream("report") == ORDER[:-1]


@pytest.mark.parametrize("name", ORDER)
def test_stage_is_what_the_table_says_and_its_parameters_are_json(name):
    stage = STAGES[name].load()
    assert (stage.name, tuple(stage.requires)) == (name, STAGES[name].requires)
    assert stage.summary
    for profile in PROFILES:
        parameters = canonical(stage.parameters(load_config(profile).config))
        assert json.loads(json.dumps(parameters, allow_nan=False)) == parameters


@pytest.mark.parametrize("name", ORDER)
def test_parameters_follow_options_and_leave_workers_out(name):
    entry, stage, loaded = STAGES[name], STAGES[name].load(), load_config("smoke")
    before = digest(stage.parameters(loaded.config))
    assert digest(stage.parameters(load_config("smoke", ["workers=1"]).config)) == before
    for option in entry.options:
        value = ["moveit"] if option.split else "another" if option.kind is str else 7
        changed = load_config("smoke", [f"{option.path}={json.dumps(value)}"])
        assert digest(stage.parameters(changed.config)) != before, option


def test_loading_every_stage_imports_nothing_heavy():
    heavy = ("torch", "mujoco", "lerobot", "matplotlib", "ompl", "toppra", "pinocchio", "h5py")
    script = (
        "import sys\n"
        "from minidual.config.loader import load_config\n"
        "from minidual.stages.registry import STAGES\n"
        "config = load_config('smoke').config\n"
        "for entry in STAGES:\n"
        "    entry.load().parameters(config)\n"
        f"print([name for name in {heavy!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[]", done.stderr
