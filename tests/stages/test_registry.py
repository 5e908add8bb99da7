"""The table of stages agrees with the stages, and asking them costs nothing."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
import types
from operator import attrgetter

import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import load_config
from minidual.errors import UsageError
from minidual.gate.canonical import canonical, digest
from minidual.gate.table import StageEntry, StageTable
from minidual.stages.registry import STAGES

ORDER = (
    "env-check",
    "plan",
    "carry",
    "teleop-record",
    "train-act",
    "deploy",
    "benchmark",
    "report",
)
PROFILES = ("smoke", "standard", "gpu")


def test_stages_stand_in_order():
    assert tuple(STAGES) == ORDER
    assert [entry.name for entry in STAGES.values() if entry.closing] == ["report"]
    assert STAGES.upstream("report") == ORDER[:-1]


@pytest.mark.parametrize("name", ORDER)
def test_a_stage_loads_and_its_parameters_are_json(name):
    entry = STAGES[name]
    assert callable(entry.load())
    assert entry.summary
    for profile in PROFILES:
        parameters = canonical(entry.parameters(load_config(profile).config))
        assert json.loads(json.dumps(parameters, allow_nan=False)) == parameters


@pytest.mark.parametrize("name", ORDER)
def test_parameters_follow_options_and_leave_workers_out(name):
    entry = STAGES[name]
    loaded = load_config("smoke")
    before = digest(entry.parameters(loaded.config))
    assert digest(entry.parameters(load_config("smoke", ["workers=1"]).config)) == before
    others = {str: "another", float: 0.7, int: 7, tuple: ["moveit"]}
    for path in entry.settings.values():
        value = others[type(attrgetter(path)(loaded.config))]
        changed = load_config("smoke", [f"{path}={json.dumps(value)}"])
        assert digest(entry.parameters(changed.config)) != before, path


def test_asking_every_stage_for_its_parameters_imports_nothing_heavy():
    # mujoco (0.2 s) may come: the Task table names the world that its conditions look at.
    heavy = ("torch", "lerobot", "matplotlib", "ompl", "toppra", "pinocchio", "h5py")
    script = (
        "import sys\n"
        "from minidual.config.loader import load_config\n"
        "from minidual.stages.registry import STAGES\n"
        "config = load_config('smoke').config\n"
        "for entry in STAGES.values():\n"
        "    entry.parameters(config)\n"
        f"print([name for name in {heavy!r} if name in sys.modules])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.strip() == "[]", done.stderr


class TestPlugIn:
    def point(self, monkeypatch, value):
        module = types.ModuleType("plugged_in_stage")
        module.ENTRY = StageEntry("shout", f"{__name__}:unused", ("report",), "Shout")
        module.WRONG = 3
        monkeypatch.setitem(sys.modules, "plugged_in_stage", module)
        point = importlib.metadata.EntryPoint("shout", value, "minidual.stages")
        monkeypatch.setattr(
            importlib.metadata,
            "entry_points",
            lambda group: [point] if group == point.group else [],
        )
        return StageTable(list(STAGES.values()))

    def test_a_row_of_another_distribution_comes_last(self, monkeypatch):
        table = self.point(monkeypatch, "plugged_in_stage:ENTRY")
        table.plug_in("minidual.stages")
        assert tuple(table) == (*ORDER, "shout")
        assert table.upstream("shout") == ORDER

    @pytest.mark.parametrize(
        "value",
        ["plugged_in_stage:WRONG", "plugged_in_stage:NONE", "no_such_module_here:X"],
    )
    def test_a_row_that_cannot_be_used_is_named(self, monkeypatch, value):
        table = self.point(monkeypatch, value)
        with pytest.raises(UsageError, match="stage 'shout' of another distribution"):
            table.plug_in("minidual.stages")

    def test_one_that_cannot_be_used_is_a_document_under_json(self, monkeypatch, capsys):
        table = self.point(monkeypatch, "plugged_in_stage:WRONG")
        assert run_command_line(["status", "--json"], table) == 2
        assert (
            "stage 'shout' of another distribution"
            in json.loads(capsys.readouterr().out)["error"]["message"]
        )

    def test_a_name_that_is_taken_is_refused(self, monkeypatch):
        table = self.point(monkeypatch, "plugged_in_stage:ENTRY")
        table.plug_in("minidual.stages")
        with pytest.raises(UsageError, match="is in the table already"):
            table.plug_in("minidual.stages")
