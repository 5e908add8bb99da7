"""Handover: the hand on the bottle's side fetches it, the other takes it in the air."""

from collections.abc import Iterator, Mapping

import numpy as np

from minidual.config.root import Config, preset
from minidual.registry import rows_beside
from minidual.robot.pair import SIDES, Array, pose, rot_z
from minidual.tasks import success
from minidual.tasks.rod_carry import draw_on_table, transported
from minidual.tasks.task import DOWN, Poses, Step, Task, TaskObject, Trial, placement

_VALUES = rows_beside(__file__)
# Exchange poses if the left hand gives. There the taker's hand points at the giver's side, and no elbow has to turn.
_MEETINGS_M = ((0.56, 0.16, 0.42), (0.56, 0.12, 0.36), (0.52, 0.24, 0.42), (0.60, 0.08, 0.42))
_MEETINGS = tuple(pose(rot_z(yaw), xyz) for xyz in _MEETINGS_M for yaw in (1.8, 1.5, 2.1))
# Places on the table for another grasp.
_ASIDE = tuple(pose(rot_z(yaw), (x, 0.28, 0.10)) for yaw in (0.0, 0.8) for x in (0.50, 0.42))
# Hand pointing along the bottle's x axis, closing along y.
_FROM_THE_SIDE = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
# Yaws of the bottle at its goal if the left hand gives [rad]; the goal's own yaw does not matter. Always the same if it
# can be: no picture tells which of several a plan takes.
_YAWS = (-0.3, 0.0, -0.6, 0.3, -0.9, 0.6, -1.2)
_ACROSS = np.diag([1.0, -1.0, 1.0, 1.0])


def handover(config: Config) -> Task:
    """Return the task."""
    config = preset(config, _VALUES)
    body = config.scene.object
    return Task(
        name="handover",
        instruction=f"Take the {body.name} with the nearer hand, pass it to the other one and stand it on the green mark.",
        config=config,
        objects={body.name: TaskObject(body, symmetry=4)},
        success=handed_over,
        draw=draw_either_way,
        stream="handover-trial",
        arrange=hand_over,
    )


def draw_either_way(
    task: Task,
    rng: np.random.Generator,
    widen: float = 1.0,
) -> tuple[Poses, Poses]:
    """Draw start and goal, mirrored in a share of the trials."""
    start, goal = draw_on_table(task, rng, widen)
    if rng.uniform() >= task.scene.task.mirrored_share:
        return start, goal
    (x, y, yaw), (goal_x, goal_y, goal_yaw) = (
        placement(where[task.carried]) for where in (start, goal)
    )
    return {task.carried: (x, -y, -yaw)}, {task.carried: (goal_x, -goal_y, -goal_yaw)}


def hand_over(task: Task, trial: Trial, seen: Mapping[str, Array]) -> Iterator[tuple[Step, ...]]:
    """Yield the steps, then those with another grasp of the giver."""
    name = task.carried
    body = task.scene.object
    to_the_right = bool(seen[name][1, 3] > 0.0)
    (giver,), (taker,) = (SIDES[:1], SIDES[1:]) if to_the_right else (SIDES[1:], SIDES[:1])

    def sided(Ts: tuple[Array, ...]) -> tuple[Array, ...]:
        return Ts if to_the_right else tuple(_ACROSS @ T @ _ACROSS for T in Ts)

    # Both hands close along one axis, along which the giver has centred the bottle. The last joint turns further one way
    # than the other: mirrored, the taker's hand is turned by half a turn.
    above = tuple(
        pose(rot_z(turn) @ DOWN, (0.0, 0.0, body.grasp_offset_m))
        for turn in (-np.pi / 2, np.pi / 2)
    )
    beside = tuple(
        pose(_FROM_THE_SIDE @ rot_z(0.0 if to_the_right else np.pi), (0.0, 0.0, z))
        for z in (0.0, -0.04)
    )
    x, y, _ = placement(trial.goal[name])
    goal = tuple(
        pose(rot_z(yaw if to_the_right else -yaw), (x, y, body.rest_height_m)) for yaw in _YAWS
    )

    def grasp(hand: str, grasps: tuple[Array, ...]) -> tuple[Step, ...]:
        return (
            Step("approach", (hand,), grasps=grasps),
            Step("descend", (hand,)),
            Step("close", (hand,)),
        )

    def leave(hand: str, *phases: str) -> tuple[Step, ...]:
        return tuple(Step(phase, (hand,)) for phase in ("open", "retreat", *phases))

    def put(hand: str, places: tuple[Array, ...]) -> tuple[Step, ...]:
        return Step("carry", (hand,), places=places), Step("lower", (hand,))

    exchange = (
        *grasp(giver, above),
        Step("carry", (giver,), places=sided(_MEETINGS)),
        *grasp(taker, beside),
        *leave(giver, "home"),
        *put(taker, goal),
        *leave(taker, "home"),
    )
    yield exchange
    yield *grasp(giver, above), *put(giver, sided(_ASIDE)), *leave(giver), *exchange


def handed_over(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions; the yaw of a bottle does not matter, and it may be put down for another grasp."""
    found = (
        c
        for c in transported(task, trial, both=False)
        if not isinstance(c, success.Turned | success.Carried)
    )
    level, held, rose, *rest = found
    stood = success.Stood(task.carried)
    exchanged = success.Exchanged(task.carried, task.scene.task.pinch_min_n)
    return level, held, stood, rose, exchanged, *rest
