"""Both arms led over a late network by a simulated leader: a hand on the table, and the rod carried.

docs/link.md describes the experiment.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.config.root import Config
from minidual.control.commands import JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import Feedback, LeaderSetup
from minidual.demos.link.linked_leader import LinkedLeader
from minidual.demos.link.simulated_leader import HandModel, SimulatedLeader
from minidual.demos.rig import Job, Rig
from minidual.motion.ik import ArmIK, solvers
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, robot_from
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.skills.operator import Demonstration
from minidual.tasks.catalogue import make_task
from scripts.bench.tables import BenchInputs

DELAYS = ("100ms", "400ms")
RATE_HZ = 100.0
_SOURCE = "teleop"
_WORSE = "jitter=20ms,loss=1%"
_PRESSED_M = 0.03
"""By how much the hand means to be below the table."""
_SPEED_M_S = 0.1
_PRESS_S = 2.0
_RELEASE_S = 1.0
_CONTACTS_N = 3
_HEIGHT_M = 0.06
_WORKSPACE_M = ((-1.0, 1.5), (-1.5, 1.5), (-0.5, 1.5))

COLUMNS = ("stopped", "success", "short_mj", "drift_end_mrad", "active_pct", "unrest_mrad_s")
_NOTES = (
    "stopped: a reflex stopped the arms; success: of the task",
    "short: by how much an observed energy was below zero, most; drift_end: of reference and leader",
    "unrest: RMS speed of all joints in the last second of the last press",
)


@dataclass(frozen=True)
class Way:
    """One of the ways to answer a late network."""

    name: str
    passive: bool = False
    takes_back_drift: bool = False
    damping: float = 0.0


WAYS = (
    Way("nothing"),
    Way("damping 20 Nm s/rad", damping=20.0),
    Way("TDPA", passive=True),
    Way("TDPA, drift taken back", passive=True, takes_back_drift=True),
)


def measure(inputs: BenchInputs) -> BenchTable:
    """Run both experiments under every way and delay."""
    rows: list[BenchRow] = []
    for delay in DELAYS:
        for way in WAYS:
            for experiment, run in (("table", run_table), ("rod", run_rod)):
                name = f"{experiment}: {way.name}, {delay}"
                rows.append(BenchRow(name, run(way, delay, inputs.seed), {}))
                inputs.advance(name)
    title = f"Both arms led over a network ({_WORSE}) at {RATE_HZ:g} Hz by simulated leader arms"
    return BenchTable(title, COLUMNS, tuple(rows), _NOTES)


def _config(way: Way, delay: str) -> Config:
    link = {
        "network": f"delay={delay},{_WORSE}",
        "passive": way.passive,
        "takes_back_drift": way.takes_back_drift,
    }
    teleop = {"rate_hz": RATE_HZ, "following": "swift", "link": link}
    return Config.model_validate({"teleop": teleop})


def run_rod(way: Way, delay: str, seed: int) -> dict[str, int | float]:
    """Let the leader carry the rod in one trial."""
    config = _config(way, delay)
    task = make_task(config)
    with tempfile.TemporaryDirectory() as folder:
        job = Job(Path(folder), task, config.teleop, config.arbiter, seed, config.supervisor)
        rig = Rig(job, cameras=())
        setup = LeaderSetup(job.robot, task, config.teleop, seed)
        leader = SimulatedLeader(hand=HandModel(added_damping=way.damping), setup=setup)
        link = LinkedLeader(leader, setup)
        result = rig.session.run(task, job.trial(0), link)
        rig.close()
    return {
        "stopped": int(bool(result.reflex)),
        "success": int(result.success),
        **_link_numbers(link),
    }


def run_table(way: Way, delay: str, seed: int) -> dict[str, int | float]:
    """Let the leader press the left hand on the table and release it, again and again."""
    config = _config(way, delay)
    robot = robot_from(config.robot)
    world = World(config.scene, robot, visuals=False)
    kinematics = Kinematics(robot)
    limits = config.supervisor.model_copy(update={"workspace_m": _WORKSPACE_M})
    stack = ControlStack(
        world,
        kinematics,
        config.arbiter,
        rate_hz=RATE_HZ,
        supervisor=Supervisor(limits, dt_s=world.dt, kinematics=Kinematics(robot)),
    )
    stack.anticipate(RATE_HZ)
    demonstration = pressing(robot, world.q)
    setup = LeaderSetup(robot, make_task(config), config.teleop, seed)
    leader = SimulatedLeader(demonstration, HandModel(added_damping=way.damping))
    link = LinkedLeader(leader, setup)
    link.align(setup.task.trial(seed, "passivity", 0), world.q)
    speeds: list[float] = []
    with contextlib.suppress(ReflexError):
        _lead(stack, link, demonstration, speeds)
    after_press_s = _RELEASE_S + _way_s()
    ends = -round(after_press_s * RATE_HZ)
    judged = np.array(speeds[ends - round(RATE_HZ) : ends])
    numbers: dict[str, int | float] = {
        "stopped": int(stack.reflex is not None),
        **_link_numbers(link),
    }
    if stack.reflex is None and len(judged):
        numbers["unrest_mrad_s"] = 1e3 * float(np.sqrt(np.mean(judged**2)))
    return numbers


def _lead(
    stack: ControlStack[World],
    link: LinkedLeader,
    demonstration: Demonstration,
    speeds: list[float],
) -> None:
    """Drive the arms along what arrives; append the norm of the joints' speeds of each tick."""
    stack.request(_SOURCE)
    while stack.source != _SOURCE:
        stack.step()
    world = stack.plant
    for k in range(round(demonstration.duration_s * RATE_HZ)):
        sample = link.read(k / RATE_HZ)
        if sample is None or sample.q is None:
            continue
        stack.propose(_SOURCE, JointCommand(sample.q, sample.openings, world.stamp_s, k))
        stack.arbitrate()
        for _ in range(stack.every):
            stack.advance()
        speeds.append(float(np.linalg.norm(world.v)))
        met_nm = stack.supervisor.observer.external.copy()
        link.feedback(Feedback(world.stamp_s, world.q, sample.openings, met_nm, met_nm))


def _way_s() -> float:
    return (_HEIGHT_M + _PRESSED_M) / _SPEED_M_S


def pressing(robot: Robot, q_start: Array) -> Demonstration:
    """Return what the hands mean: the left one goes down, presses and releases, hands closed."""
    ik = next(iter(solvers(robot).values()))
    T_above = ik.tcp_pose(q_start[ik.joints])
    T_above[2, 3] = _HEIGHT_M
    steps_n = round(_way_s() * RATE_HZ)
    above = _solved(ik, T_above, q_start[ik.joints])
    down: list[Array] = [above]
    T = T_above.copy()
    for k in range(1, steps_n + 1):
        T[2, 3] = _HEIGHT_M - (_HEIGHT_M + _PRESSED_M) * k / steps_n
        down.append(_solved(ik, T, down[-1]))
    press = [down[-1]] * round(_PRESS_S * RATE_HZ)
    release = [above] * round(_RELEASE_S * RATE_HZ)
    contact = [*down, *press, *reversed(down), *release]
    approach_n = round(3.0 * RATE_HZ)
    shares = np.linspace(0.0, 1.0, approach_n)
    smooth = shares * shares * (3.0 - 2.0 * shares)
    approach = [(1.0 - s) * q_start[ik.joints] + s * above for s in smooth]
    left = np.array([*approach, *(contact * _CONTACTS_N)])
    q = np.tile(q_start, (len(left), 1))
    q[:, ik.joints] = left
    return Demonstration(RATE_HZ, q, np.zeros((len(left), 2)))


def _solved(ik: ArmIK, T: Array, near: Array) -> Array:
    return ik.resting(T, near, near, np.ones(len(near))).q


def _link_numbers(link: LinkedLeader) -> dict[str, int | float]:
    measures = link.measures()
    return {
        "short_mj": max(0.0, -1e3 * measures["link_energy_min_j"]),
        "drift_end_mrad": 1e3 * measures["link_drift_end"],
        "active_pct": 100.0 * measures["link_active_share"],
    }
