"""The demonstration of the three modes: measurements, refusals, and that it can fail."""

from __future__ import annotations

import csv
import itertools
import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.control import ArbiterConfig, CarryConfig
from minidual.config.root import Config, changed
from minidual.control.commands import Refusal, TrajectoryCommand
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import (
    ConfigError,
    EnvironmentMissingError,
    ExitCode,
    GateClosedError,
    UsageError,
)
from minidual.gate.stage import ToolContext
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.operator import ScriptedOperator
from minidual.stages.modes import find_checkpoint, modes
from minidual.stages.modes_film import Bar, captioned
from minidual.tasks.task import Trial
from minidual.trials import modes_turns
from minidual.trials.modes import DEFAULT_MODES, ModesDemo, Switch, parse_modes
from minidual.trials.modes_turns import Turn
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.panda import HOME

SEED = 11


class Mimic:
    """Stands in for a trained policy: commands the posture it sees, drops its queue on request."""

    inference_hz = 100.0
    joints_n = len(HOME)

    def __init__(self, step_rad: float = 0.0) -> None:
        self.cameras: dict[str, tuple[int, int]] = {}
        self.inputs: dict[str, int] = {}
        self.step_rad = step_rad
        self.flushes = 0

    def reset(self) -> None:
        self.flushes += 1

    def act(self, images: Any, state: Array) -> Array:
        return np.r_[HOME + self.step_rad, 1.0, 1.0]


class Stage:
    """The world of the demonstration, and the drivers of its modes."""

    def __init__(self, world: World, *, supervised: bool = True) -> None:
        scene = world.scene
        self.world = world
        self.trial: Trial = sample_trial(scene, SEED, "modes", 0)
        world.reset(poses=self.trial.goal)
        guard = Supervisor(dt_s=world.dt) if supervised else None
        self.stack = ControlStack(world, Kinematics(), supervisor=guard)
        self.runtime: Any = Mimic()
        self.seen = modes_turns.KnownObject(scene, world.object_pose)

    def moveit(self, *, home: bool, share: float = 1.0) -> Turn:
        return modes_turns.moveit(self.stack, Planner(), SEED, self.seen, home=home, share=share)

    def teleop(self) -> Turn:
        return modes_turns.teleop(
            self.stack,
            ScriptedOperator(self.world.scene),
            self.trial,
            SEED,
            50.0,
            self.seen,
        )

    def policy(self) -> Turn:
        picture = lambda name: np.zeros((1, 1, 3), np.uint8)  # noqa: E731
        return modes_turns.policy(
            self.stack,
            self.runtime,
            picture,
            carry_task(self.world.scene),
            self.trial,
            self.world,
        )


def test_planner_leader_and_planner_again_carry_the_rod_within_every_bound(
    world: World,
    tmp_path: Path,
) -> None:
    stage = Stage(world)
    demo = ModesDemo(
        stage.stack,
        [stage.moveit(home=False, share=0.5), stage.teleop(), stage.moveit(home=True)],
    )
    steps = [turn.mode for turn in demo.steps()]
    assert demo.ended is None
    assert demo.exceeded(ArbiterConfig()) == []
    first, second, third = demo.switches
    assert first.speed_at_request_rad_s == 0.0
    assert second.speed_at_request_rad_s > 0.5, "the leader is to interrupt arms in motion"
    assert 0.05 < second.confirmed_s - second.requested_s < 0.5
    assert third.controllers == ("left_arm", "right_arm")
    for switch in demo.switches:
        assert 0.0 < switch.reference_step_ratio <= 1.0
        assert 0.0 < switch.torque_step_nm <= 1.0 + 1e-9
        assert switch.first_step_rad < 0.1
        assert switch.first_command_s >= switch.confirmed_s
    assert demo.outcomes[1]["goal_error_m"] < 0.005
    np.testing.assert_allclose(world.q, HOME, atol=5e-3)
    assert len(steps) == round(world.time / world.dt)
    assert steps[0] == "moveit"
    assert len(demo.rows) == -(-len(steps) // 4)
    assert {r["active_source"] for r in demo.rows} == {"", "moveit", "teleop"}
    assert {"settling", "active"} <= {r["state"] for r in demo.rows}
    json.dumps(demo.record(ArbiterConfig()), allow_nan=False)


def test_a_stack_without_a_given_supervisor_bounds_torque_steps_too(world: World) -> None:
    stage = Stage(world, supervised=False)
    stage.runtime = Mimic(step_rad=0.05)
    demo = ModesDemo(stage.stack, [stage.policy()])
    steps = demo.steps()
    for _ in range(800):
        next(steps)
    switch = demo.switches[0]
    assert switch.torque_step_asked_nm > 1.0 + 1e-9
    assert switch.torque_step_nm <= 1.0 + 1e-9
    assert not any("torque_step_nm" in text for text in demo.exceeded(ArbiterConfig()))


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("first_step_rad", {"first_step_rad": 0.11}),
        ("first_step_rad", {"first_step_rad": float("nan")}),
        ("target_step_rad", {"target_step_rad": 0.11}),
        ("reference_step_ratio", {"reference_step_ratio": 1.01}),
        ("torque_step_nm", {"torque_step_nm": 1.01}),
        ("torque_step_nm", {"torque_step_nm": float("nan")}),
    ],
)
def test_every_bound_can_fail(name: str, changes: dict[str, float]) -> None:
    fine = {
        "first_step_rad": 0.01,
        "reference_step_ratio": 0.9,
        "torque_step_nm": 0.9,
        "target_step_rad": 0.01,
    }
    demo = ModesDemo.__new__(ModesDemo)
    demo.switches = [Switch("teleop", 1.0, **fine)]
    assert demo.exceeded(ArbiterConfig()) == []
    demo.switches.append(Switch("teleop", 1.0, **{**fine, **changes}))
    exceeded = demo.exceeded(ArbiterConfig())
    assert len(exceeded) == 1
    assert exceeded[0].startswith(f"switch to teleop at 1.00 s: {name}")


def test_the_policy_gets_its_turn_and_its_queue_is_dropped_at_every_switch(world: World) -> None:
    stage = Stage(world)
    demo = ModesDemo(stage.stack, [stage.policy(), stage.moveit(home=True)])
    for turn in demo.steps():
        if turn.mode == "moveit":
            break
    limit = world.scene.task.time_limit_s
    assert world.time == pytest.approx(limit + 0.02, abs=0.05), (
        "a policy that does nothing is ended by the clock"
    )
    assert stage.runtime.flushes == 3  # at two switches, and when its turn begins
    assert demo.outcomes[0]["put_down_at_goal"] is False


def test_a_mode_that_falls_silent_ends_the_demonstration(world: World) -> None:
    stage = Stage(world)

    def silent() -> modes_turns.Steps:
        while True:
            yield

    demo = ModesDemo(stage.stack, [Turn("teleop", "", silent), stage.moveit(home=True)])
    assert {turn.mode for turn in demo.steps()} == {"teleop"}
    assert re.fullmatch(
        r"mode 'teleop' lost its turn at 1\.\d+ s: no command came",
        str(demo.ended),
    )


def test_the_caption_changes_with_who_drives(world: World) -> None:
    stage = Stage(world)
    picture = np.zeros((90, 160, 3), np.uint8)
    turn = stage.teleop()
    held = captioned(picture, Bar.of(stage.stack, turn))
    assert held.shape[0] > 90
    assert held.shape[1] == 160
    steps = ModesDemo(stage.stack, [turn]).steps()
    for _ in range(60):
        next(steps)
    driven = captioned(picture, Bar.of(stage.stack, turn))
    assert stage.stack.output.active_source == "teleop"
    assert not np.array_equal(held[95:], driven[95:])


def test_a_planner_alone_moves_the_arms(tmp_path: Path) -> None:
    """Its first motion leads away from home, where the arms stand."""
    result = modes(_context(tmp_path / "run", modes="moveit"))
    assert result.exit_code == ExitCode.PASS
    (outcome,) = result.data["outcomes"]
    assert outcome["from_home_rad"] > 0.1


def test_modes_are_parsed_or_refused() -> None:
    assert parse_modes("moveit, teleop") == ("moveit", "teleop")
    assert DEFAULT_MODES == ("moveit", "teleop", "policy", "moveit")
    with pytest.raises(UsageError, match=r"(?s)no mode 'polcy'.*did you mean 'policy'"):
        parse_modes("moveit,polcy")
    with pytest.raises(UsageError, match="twice in sequence"):
        parse_modes("moveit,moveit")
    with pytest.raises(UsageError, match="no mode named"):
        parse_modes(" , ")


def _context(run: Path, **options: str) -> ToolContext:
    return ToolContext(
        config=Config(),
        seed=SEED,
        profile="standard",
        run_folder=run,
        options=options,
        name="modes",
    )


def test_without_a_policy_nothing_is_put_in_its_place(tmp_path: Path) -> None:
    with pytest.raises(GateClosedError) as caught:
        modes(_context(tmp_path / "standard"))
    assert caught.value.exit_code == ExitCode.GATE_CLOSED
    assert "run 'standard' has none" in caught.value.message
    assert "minidual run --until train-act" in str(caught.value.remedy)
    assert "--modes moveit,teleop,moveit" in str(caught.value.remedy)
    assert not list((tmp_path).iterdir()), "nothing is written before it can run"
    with pytest.raises(UsageError, match=r"there is no policy \(config.json\)"):
        find_checkpoint(_context(tmp_path, checkpoint=str(tmp_path)))
    folder = tmp_path / "train-act" / "checkpoint"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    assert find_checkpoint(_context(tmp_path)) == folder


def test_modes_demonstrates_what_carry_carries(tmp_path: Path) -> None:
    """It broke off at other objects ("no object 'box'"), and led xArm7s with the Panda's model."""
    context = _context(tmp_path / "run", modes="moveit,teleop,moveit")
    with pytest.raises(ConfigError, match="in the task 'handover' they do not"):
        modes(replace(context, config=Config(task="handover")))
    boxed = replace(context, config=Config(carry=CarryConfig(object="box")))
    with pytest.raises(
        EnvironmentMissingError,
        match="films no more",
    ):  # the world stands, the modes are prepared
        _prepared(modes, boxed)


def _prepared(run: Callable[[ToolContext], Any], context: ToolContext) -> None:
    def refuse(*_args: object, **_options: object) -> int:
        raise EnvironmentMissingError("films no more")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("minidual.stages.modes.shots_of", refuse)
        run(context)


def _refuse(
    monkeypatch: pytest.MonkeyPatch,
    *,
    sequence: int,
    change: Callable[[Any], Any] | None = None,
) -> None:
    """Let the planner's trajectory of that number be refused, at once or at the next tick."""
    propose = ControlStack.propose

    def proposed(self: ControlStack, source: str, command: Any) -> Refusal | None:
        if source != "moveit" or command.sequence != sequence:
            return propose(self, source, command)
        if change is None:
            return Refusal(source, "stale", "it is too old")
        return propose(self, source, change(command))

    monkeypatch.setattr(ControlStack, "propose", proposed)


def _elsewhere(command: Any) -> TrajectoryCommand:
    """Return the command from another start than where the arms are."""
    return replace(command, motion=replace(command.motion, q=command.motion.q + 0.3))


@pytest.mark.parametrize("change", [None, _elsewhere])
def test_a_refused_second_motion_of_the_planner_is_no_success(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Any], Any] | None,
) -> None:
    stage = Stage(world)
    _refuse(monkeypatch, sequence=2, change=change)
    demo = ModesDemo(stage.stack, [stage.moveit(home=True)])
    list(demo.steps())
    assert re.match(r"trajectory 2 of mode 'moveit' was refused at \d+\.\d+ s", str(demo.ended))
    assert demo.outcomes == []


def test_a_demonstration_that_ends_early_leaves_its_log_and_exits_1(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _refuse(monkeypatch, sequence=1)
    context = _context(tmp_path, modes="moveit,teleop")
    result = modes(context)
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert any(
        note.startswith("ENDED TOO EARLY: trajectory 1 of mode 'moveit'") for note in result.notes
    )
    assert "every step at every switch within its bound" not in result.notes
    document = json.loads((context.output / "modes.json").read_text())
    assert "it is too old" in document["ended"]
    assert [s["mode"] for s in document["switches"]] == ["moveit"]
    with (context.output / "modes.csv").open() as file:
        assert len(list(csv.DictReader(file))) > 1
    assert (context.output / "modes.mp4").stat().st_size > 0


def test_on_a_plant_without_cameras_signals_are_drawn_and_the_policy_is_refused(
    tmp_path: Path,
) -> None:
    arms = {"plant.address": "tests.support.position_plant:gentle"}
    context = _context(tmp_path, modes="moveit,teleop,moveit")
    context = replace(context, config=changed(context.config, arms))
    result = modes(context)
    context.publish()
    assert result.data["place"] == "test double"
    assert result.data["ended"] is None
    assert len(result.data["switches"]) == 3
    assert (tmp_path / "modes" / "modes.svg").is_file()
    assert not (tmp_path / "modes" / "modes.mp4").exists()
    assert any("nothing senses the object" in note for note in result.notes)
    folder = tmp_path / "train-act" / "checkpoint"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    with pytest.raises(UsageError, match="looks through cameras, and plant"):
        modes(replace(context, options={"modes": "moveit,policy"}))


def test_where_time_runs_on_the_arms_are_held_while_a_plan_is_made(world: World) -> None:
    stack = Stage(world).stack
    world.catch_up = lambda: None  # type: ignore[attr-defined]
    stack.request("moveit")
    while stack.source != "moveit":
        stack.step()
    began_s = world.time
    held = modes_turns.while_held(stack, "moveit", itertools.count(1), lambda: time.sleep(0.2) or 7)
    result = None
    while True:
        try:
            next(held)
        except StopIteration as ended:
            result = ended.value
            break
        stack.step()
    assert result == 7
    assert world.time > began_s
    assert stack.source == "moveit"
    np.testing.assert_allclose(world.q, HOME, atol=5e-3)
