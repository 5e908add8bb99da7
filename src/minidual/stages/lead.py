"""`minidual lead`: a leader drives the arms of any plant, without a task or a recording."""

import math
from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import Any

import numpy as np

from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.demos.free_lead import FreeLead, LeadTick, Led
from minidual.demos.lag import leader_lag
from minidual.demos.leader import LEADERS, Leader, LeaderSetup, follows_swiftly
from minidual.durable import write_csv
from minidual.errors import ExitCode, NothingEvaluatedError, UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner
from minidual.plant.connect import SIMULATOR, connection
from minidual.plant.lifecycle import Connection, planned_robot
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot, robot_from
from minidual.show.watch import StackNarrator
from minidual.show.watch_plant import watched_plant
from minidual.skills.plant_home import bring_home
from minidual.skills.supervised import trial_supervisor
from minidual.stages.leading import station_of, web_view
from minidual.tasks.catalogue import make_task

PURPOSE = "lead"
"""Random stream of the start."""
_SECONDS = 60.0
_SECONDS_MAX = 3600.0


def lead(context: ToolContext) -> ToolResult:
    """Lead until the time is over, the leader ends it or falls silent; write lead.csv.

    Exit 1 after a reflex.

    Raises:
        UsageError: A wrong time, leader or plant; leader and arms are apart.
        NothingEvaluatedError: The leader ended it before the first tick.
    """
    seconds = float(context.options.get("seconds", _SECONDS))
    if not 0.0 < seconds <= _SECONDS_MAX:
        raise UsageError(f"--seconds is {seconds:g}; 0 < value <= {_SECONDS_MAX:g}")
    config = make_task(context.config).config
    kind = LEADERS[config.teleop.leader]
    if kind.usage:
        context.progress.note(kind.usage)
    arms = robot_from(config.robot)
    with ExitStack() as stack, connection(config.plant, arms, config.scene) as link:
        robot = link.plant.robot
        view = context.view
        if view is None and kind.features.picture:
            view = stack.enter_context(closing(web_view(context)))
        station = station_of(context, kind, view, stack)
        setup = LeaderSetup(robot, make_task(config), config.teleop, context.seed, station)
        leader = kind.connect(setup)
        stack.callback(leader.close)
        control = _control(context, config, link)
        narrate = StackNarrator(control, Kinematics(robot), "lead")
        draw = stack.enter_context(watched_plant(view, link, config.scene, narrate))
        context.progress.note(f"lead now, at most {seconds:g} s")
        session = FreeLead(control, config.teleop, leader, station, draw)
        led = session.run(make_task(config).trial(context.seed, PURPOSE, 0), seconds)
        place = link.place
    if not led.ticks:
        raise NothingEvaluatedError(
            f"nothing was led: ended by {led.ended_by}",
            remedy="start the leader, then type the command again",
        )
    write_csv(context.output / "lead.csv", [_row(tick, robot) for tick in led.ticks])
    numbers = numbers_of(led, config.teleop.rate_hz)
    data = {
        "plant": config.plant.address,
        "place": place,
        "leader": config.teleop.leader,
        "ended_by": led.ended_by,
        "reflex": led.reflex,
        "refusals": [refusal.name for refusal in led.refusals],
        "dropped": leader.hint,
        **numbers,
    }
    lines = [f"{name}: {_text(value)}" for name, value in numbers.items()]
    lines.append(str(context.folder / "lead.csv"))
    code = ExitCode.ACCEPTANCE_FAILED if led.reflex else ExitCode.PASS
    return ToolResult(lines, _notes(led, leader, place), data, code)


def _control(context: ToolContext, config: Config, link: Connection) -> ControlStack[Plant]:
    """Bring the arms home, put the objects at a start, and return the control stack."""
    plant: Plant = link.plant
    if config.plant.address != SIMULATOR:
        context.progress.note("the arms go home")
        planner = Planner(config=config.plan.planner, robot=planned_robot(plant))
        bring_home(link, config, planner, context.seed)
    twin = link.twin()
    if twin is not None:
        twin.place(make_task(config).trial(context.seed, PURPOSE, 0).start)
    stack = ControlStack(
        plant,
        Kinematics(plant.robot),
        config.arbiter,
        rate_hz=config.teleop.rate_hz,
        supervisor=trial_supervisor(config.supervisor, plant.dt, plant.robot),
    )
    if follows_swiftly(config.teleop):
        stack.anticipate(config.teleop.rate_hz)
    return stack


def numbers_of(led: Led, rate_hz: float) -> dict[str, float]:
    """Return the measurements; NaN for events that did not happen."""
    ticks = led.ticks
    action = np.array([tick.action for tick in ticks])
    q = np.array([tick.q for tick in ticks])
    times_s = np.array([tick.time_s for tick in ticks])
    span_s = float(times_s[-1] - times_s[0])
    return {
        "ticks": float(len(ticks)),
        "rate_hz": (len(ticks) - 1) / span_s if span_s > 0.0 else math.nan,
        "lag_s": leader_lag(action, q, rate_hz).aligned_s,
        "command_p99_s": float(np.percentile([tick.command_s for tick in ticks], 99)),
        "age_p99_s": _percentile([tick.age_s for tick in ticks]),
        "late_ticks": float(np.sum(np.diff(times_s) > 1.5 / rate_hz)),
        "turned_rad": float(np.ptp(q, axis=0).max()),
    }


def _percentile(values: Sequence[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.percentile(finite, 99)) if finite else math.nan


def _text(value: float) -> str:
    return "not measured" if math.isnan(value) else f"{value:.4g}"


def _row(tick: LeadTick, robot: Robot) -> dict[str, Any]:
    row: dict[str, Any] = {"time_s": f"{tick.time_s:.4f}"}
    names = robot.joint_names
    row |= {name: f"{value:.5f}" for name, value in zip(names, tick.q, strict=True)}
    pairs = zip(names, tick.action, strict=True)
    row |= {f"{name} commanded": f"{value:.5f}" for name, value in pairs}
    row["left opening"], row["right opening"] = (f"{value:.3f}" for value in tick.gripper)
    row["age_s"] = f"{tick.age_s:.4f}"
    row["command_s"] = f"{tick.command_s:.5f}"
    return row


def _notes(led: Led, leader: Leader, place: str) -> list[str]:
    notes = [f"driven: {place}; ended by {led.ended_by}"]
    if led.reflex:
        notes.append(f"STOPPED: {led.reflex}")
    if led.held:
        notes.append(f"the arms held: {led.held}")
    if leader.hint:
        notes.append(leader.hint)
    names = [refusal.name for refusal in led.refusals]
    notes += [f"refused as {name}: {names.count(name)}" for name in sorted(set(names))]
    return notes
