"""`minidual doctor` names each fault with its remedy, and looks at every part."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from minidual.config.loader import load_config
from minidual.errors import EnvironmentMissingError, ExitCode
from minidual.gate.check import Check
from minidual.gate.gate import Gate
from minidual.gate.runner import Runner
from minidual.gate.stage import StageContext, ToolContext, ToolResult
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.policies.policy import EmittedActions
from minidual.robot.pair import DUAL_PANDA
from minidual.stages import doctor
from minidual.stages.registry import STAGES, TOOLS
from tests.support import data_samples
from tests.support.late import late
from tests.support.pipeline_toys import Toy

adapter = late("minidual.demos.lerobot_adapter")
SETTINGS = [
    "teleop.cameras=[high,left]",
    "plan.planner.range_rad=0.9",
    "plan.success_rate_min=0.99",
]


class Patient:
    """A run whose simulator is three toys."""

    def __init__(self, root: Path) -> None:
        names = "env-check", "plan", "carry"
        self.toys = [Toy(name, names[:k][-1:]) for k, name in enumerate(names)]
        self.table = StageTable(
            [StageEntry(t.name, t, t.requires, "Toy") for t in self.toys],
            ("numpy",),
        )
        self.store = RunStore(root, "patient")
        self.loaded = load_config("standard", SETTINGS)

    def run(self) -> None:
        list(Runner(self.table, self.store, self.loaded).run_until(None))

    def examined(self) -> tuple[ToolResult, dict[str, dict[str, Any]], list[dict[str, Any]]]:
        context = ToolContext(
            config=self.loaded.config,
            seed=3,
            profile="standard",
            run_folder=self.store.folder,
            name="doctor",
            gate=Gate(self.table, self.store, self.loaded),
        )
        context.begin()
        result = doctor.doctor(context)
        return (
            result,
            {row["part"]: row for row in result.data["parts"]},
            list(result.data["faults"]),
        )


@pytest.fixture
def patient(tmp_path: Path) -> Patient:
    return Patient(tmp_path)


def episodes(patient: Patient, *changed: tuple[str, Any]) -> list[Path]:
    """Write three episodes into the run; the last has some arrays changed."""
    folder = patient.store.folder / "teleop-record" / "episodes"
    paths = []
    for k in range(3):
        data = data_samples.arrays(seed=k, cameras=("high", "left"))
        data |= {key: 0.5 * data[key] + DUAL_PANDA.home for key in ("qpos", "action")}
        if k == 2:
            data |= {key: value(data) for key, value in changed}
        paths.append(data_samples.write(folder / f"episode_{k:06d}.hdf5", data, seed=k))
    return paths


def test_a_sound_machine_without_results_has_no_fault(patient: Patient) -> None:
    result, parts, faults = patient.examined()
    assert (result.exit_code, faults) == (ExitCode.PASS, [])
    assert list(parts) == ["env-check", "plan", "carry", "results", "recordings", "policy"]
    assert [parts[name]["examined"] for name in ("carry", "results", "recordings", "policy")] == [
        "2 checks",
        *["nothing yet"] * 3,
    ]
    assert result.lines[-1] == "no known fault found"


def test_stages_run_at_a_small_size_with_the_settings_of_the_run(patient: Patient) -> None:
    patient.examined()
    context = patient.toys[2].contexts[0]
    config = context.config
    smoke = load_config("smoke").config
    assert 1 <= config.plan.queries_n <= smoke.plan.queries_n
    assert 1 <= config.plan.held.executed_n <= smoke.plan.held.executed_n
    assert 1 <= config.carry.trials_n <= smoke.carry.trials_n
    assert config.env_check.sine_duration_s == 2.0, "one period"
    assert not context.pictures
    assert config.carry.limits == patient.loaded.config.carry.limits != smoke.carry.limits
    assert config.plan.planner == patient.loaded.config.plan.planner != smoke.plan.planner
    assert config.plan.success_rate_min == 0.99 != smoke.plan.success_rate_min
    assert config.teleop.cameras == ("high", "left")


def test_the_real_stages_up_to_carry_are_examined_and_can_be_stopped() -> None:
    assert list(STAGES.until("carry")) == ["env-check", "plan", "carry"]
    (tool,) = (tool for tool in TOOLS if tool.name == "doctor")
    assert tool.moves, "`minidual stop` finds only what moves arms"
    assert tool.load() is doctor.doctor


def test_a_failed_check_is_a_fault_with_its_remedy(patient: Patient) -> None:
    patient.toys[1].observed = 0.5
    result, parts, faults = patient.examined()
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert faults == [
        {
            "part": "plan",
            "level": "both arms",
            "name": "quality",
            "detail": "quality is 0.5 n, limit >= 1 n",
            "remedy": "hold harder",
            "count": 1,
            "follows": None,
            "trouble": None,
        },
    ]
    assert [parts[name]["faults"] for name in ("env-check", "plan", "carry")] == [0, 1, 0]
    assert "both arms: plan: quality: quality is 0.5 n, limit >= 1 n" in result.lines
    assert "  remedy: hold harder" in result.lines


def test_what_stops_one_part_does_not_stop_the_others(patient: Patient) -> None:
    def missing(context: StageContext) -> Sequence[Check] | None:
        raise EnvironmentMissingError("no off-screen OpenGL", remedy="apt-get install libegl1")

    patient.toys[0].behaviour = missing
    episodes(patient)
    result, parts, faults = patient.examined()
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert [(f["part"], f["detail"], f["remedy"]) for f in faults] == [
        ("env-check", "no off-screen OpenGL", "apt-get install libegl1"),
    ]
    assert (parts["env-check"]["examined"], parts["plan"]["examined"]) == ("stopped", "2 checks")
    assert parts["recordings"]["examined"] == "3 episodes"


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (
            (
                "images",
                lambda data: dict(
                    zip(("high", "left"), [*data["images"].values()][::-1], strict=True),
                ),
            ),
            "cameras_swapped",
        ),
        (
            ("images", lambda data: {c: np.zeros_like(x) for c, x in data["images"].items()}),
            "images_black",
        ),
        (("qpos", lambda data: data["qpos"] + 10.0), "outside_joint_limits"),
        (("timestamps", lambda data: data["timestamps"] * 1.5), "rate_wrong"),
    ],
)
def test_each_fault_of_a_recording_is_named_with_its_file(
    patient: Patient,
    change: tuple[str, Any],
    name: str,
) -> None:
    episodes(patient)
    assert patient.examined()[2] == [], "the same episodes, sound"
    for path in (patient.store.folder / "teleop-record" / "episodes").iterdir():
        path.unlink()
    episodes(patient, change)
    result, _, faults = patient.examined()
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    found = [fault for fault in faults if fault["name"] == name]
    assert found, faults
    assert {fault["part"] for fault in faults} == {"recordings"}
    assert all(
        fault["detail"].startswith("episode_000002.hdf5: ") and fault["remedy"] for fault in faults
    )


def test_actions_that_were_overwritten_by_readings_are_named(patient: Patient) -> None:
    with h5py.File(episodes(patient)[1], "r+") as file:
        file["action"][...] = file["observations/qpos"][...]
    assert [fault["name"] for fault in patient.examined()[2]] == ["action_equals_qpos"]


def test_a_truncated_episode_is_named(patient: Patient) -> None:
    path = episodes(patient)[0]
    path.write_bytes(path.read_bytes()[:2000])
    (fault,) = patient.examined()[2]
    assert fault["part"] == "recordings"
    assert fault["detail"].startswith("episode_000000.hdf5: ")


def test_stale_and_broken_results_are_named(patient: Patient) -> None:
    patient.run()
    assert patient.examined()[2] == [], "as they were made"
    artefact = patient.store.stage_folder("env-check") / "out" / "numbers.txt"
    artefact.write_text("9")
    (patient.store.stage_folder("carry") / "verdict.json").write_text("{")
    result, parts, faults = patient.examined()
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert parts["results"]["examined"] == "env-check, plan, carry"
    assert [fault["name"] for fault in faults] == [
        "env-check is stale",
        "plan is stale",
        "carry is error",
    ]
    assert "artefact out/numbers.txt changed" in faults[0]["detail"]
    assert faults[0]["remedy"] == "minidual explain env-check"


def test_an_interrupted_stage_is_named(patient: Patient) -> None:
    patient.store.begin("env-check", "")
    patient.store.abandon("env-check", "interrupted", "Ctrl-C")
    (fault,) = patient.examined()[2]
    assert (fault["name"], fault["remedy"]) == (
        "env-check is incomplete",
        "minidual explain env-check",
    )
    assert "Ctrl-C" in fault["detail"]


@pytest.mark.torch
def test_a_damaged_dataset_and_a_policy_beyond_the_limits_are_named(
    patient: Patient,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dataset = patient.store.folder / "teleop-record" / "lerobot"
    adapter.convert(episodes(patient), dataset, DUAL_PANDA)
    result, parts, faults = patient.examined()
    assert (faults, parts["policy"]["examined"]) == ([], "dataset of 120 ticks"), result.lines

    emitted = EmittedActions(in_limits=1.0, overshoot_max_rad=0.0, targets_n=16, inference_hz=300.0)
    (patient.store.folder / "train-act" / "checkpoint").mkdir(parents=True)
    monkeypatch.setattr(doctor, "exercise_checkpoint", lambda *_: emitted)
    assert patient.examined()[1]["policy"] == {
        "part": "policy",
        "examined": "dataset of 120 ticks, checkpoint",
        "faults": 0,
    }
    monkeypatch.setattr(
        doctor,
        "exercise_checkpoint",
        lambda *_: emitted._replace(in_limits=0.5, targets_n=14),
    )
    assert [fault["name"] for fault in patient.examined()[2]] == ["actions_in_limits", "targets_n"]

    info = dataset / "meta" / "info.json"
    info.write_text(json.dumps(json.loads(info.read_text()) | {"total_frames": 7}))
    (fault,) = patient.examined()[2]
    assert fault["part"] == "policy"
    assert "7 frames" in fault["detail"]
    assert fault["remedy"]
