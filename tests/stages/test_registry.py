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


CHOICES = {"report.language": "zh", "teleop.link.network": "delay=100ms"}
"""Other values of options that take only some texts."""


@pytest.mark.parametrize("name", ORDER)
def test_parameters_follow_options_and_leave_workers_out(name):
    entry = STAGES[name]
    loaded = load_config("smoke")
    before = digest(entry.parameters(loaded.config))
    assert digest(entry.parameters(load_config("smoke", ["workers=1"]).config)) == before
    others = {str: "another", float: 0.7, int: 7, tuple: ["moveit"], dict: {"act": "elsewhere"}}
    for path in entry.settings.values():
        value = CHOICES.get(path, others[type(attrgetter(path)(loaded.config))])
        changed = load_config("smoke", [f"{path}={json.dumps(value)}"])
        assert digest(entry.parameters(changed.config)) != before, path


JUDGED = ("goal_tolerance_m=0.03", "time_limit_s=20", "pinch_min_n=30", "yaw_tolerance_rad=0.05")
"""Values of `scene.task` by which only the end of a trial is judged."""
PLANNED = ("lift_height_m=0.2", "tilt_max_rad=0.05", "goal_range_rad=0.1", "start_range_rad=0.1")
"""Values of `scene.task` that planning reads, and the model of the scene does not."""
PLACED = ("start_range_m=0.08", "goal_xy_m=[0.45,-0.2]", "obstacle={}")
"""Values of `scene.task` that the model of the scene reads."""


@pytest.mark.parametrize(
    ("value", "stale"),
    [
        *((value, {"carry"}) for value in JUDGED),
        *((value, {"plan", "carry"}) for value in PLANNED),
        *((value, {"env-check", "plan", "carry"}) for value in PLACED),
    ],
)
def test_a_value_of_the_task_concerns_only_the_stages_that_read_it(value, stale):
    before = load_config("standard").config
    after = load_config("standard", [f"scene.task.{value}"]).config
    names = ("env-check", "plan", "carry")
    differing = {n for n in names if STAGES[n].parameters(after) != STAGES[n].parameters(before)}
    assert differing == stale


def test_a_shorter_carry_weakens_the_planning_of_it_too():
    loaded = load_config("standard", ["scene.task.goal_xy_m=[0.5, 0.2]"])
    for name in ("plan", "carry"):
        (line,) = STAGES[name].weaker(loaded.config, loaded.reference())
        assert line.startswith("scene.task.distance_m is 0.05")


@pytest.mark.parametrize(
    ("methods", "needed"),
    [
        ("moveit,impedance", ("carry",)),
        ("hold", ("carry",)),
        ("moveit,rl", ("carry",)),
        ("moveit,act", ("carry", "deploy")),
        ("act", ("carry", "deploy")),
        ("moveit,no_such_method", ("carry", "deploy")),
    ],
)
def test_a_benchmark_needs_a_policy_only_for_a_method_that_drives_it(methods, needed):
    config = load_config("standard", [f"benchmark.methods=[{methods}]"]).config
    assert STAGES["benchmark"].required(config) == needed


def test_a_policy_from_elsewhere_needs_no_training_and_is_no_acceptance():
    settings = ["benchmark.methods=[moveit, impedance, act]", "benchmark.policies={act: elsewhere}"]
    loaded = load_config("standard", settings)
    assert STAGES["benchmark"].required(loaded.config) == ("carry",)
    weaker = STAGES["benchmark"].weaker(loaded.config, loaded.reference())
    assert any("benchmark.own_policies" in line for line in weaker)


def test_every_other_stage_needs_what_it_requires():
    config = load_config("standard").config
    assert STAGES["deploy"].required(config) == ("train-act",)
    for entry in STAGES.values():
        if entry.name != "deploy":
            assert entry.required(config) == entry.requires


def test_deploy_of_a_policy_from_elsewhere_needs_no_training_and_is_no_acceptance():
    loaded = load_config("standard", ["deploy.policy=elsewhere"])
    assert STAGES["deploy"].required(loaded.config) == ("carry",)
    weaker = STAGES["deploy"].weaker(loaded.config, loaded.reference())
    assert any("deploy.own_policy" in line for line in weaker)


def test_inputs_are_artefacts_of_upstream_stages():
    for entry in STAGES.values():
        for stage in entry.inputs or ():
            assert stage in STAGES.upstream(entry.name)
    assert STAGES["report"].inputs is None, "it may read all"


@pytest.mark.parametrize(
    ("stage", "path", "reads"),
    [
        ("deploy", "train-act/checkpoint/model.safetensors", True),
        ("deploy", "train-act/seed-2/checkpoint/config.json", True),
        ("deploy", "train-act/loss.csv", False),
        ("deploy", "teleop-record/episodes/episode_0001.hdf5", True),
        ("train-act", "teleop-record/lerobot/data/chunk-000/file-000.parquet", True),
        ("train-act", "teleop-record/quality.csv", False),
        ("teleop-record", "carry/trials.csv", False),
        ("benchmark", "train-act/checkpoint/model.safetensors", True),
        ("benchmark", "deploy/trials.csv", False),
        ("report", "benchmark/benchmark.csv", True),
    ],
)
def test_which_artefacts_a_stage_reads(stage, path, reads):
    upstream, _, name = path.partition("/")
    assert STAGES[stage].reads_artefact(upstream, name) is reads


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
