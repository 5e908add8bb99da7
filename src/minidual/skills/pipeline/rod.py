"""The rod's own task: candidates of grips and places, and the stages that carry it from one to the other."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from minidual.collision.shapes import Capsule
from minidual.robot.constants import ARMS, HOME, Array
from minidual.robot.poses import pose, rot_x, rot_z
from minidual.skills.pipeline.carrying import ChoosePlace, Lift, Place, PutDown, Transport
from minidual.skills.pipeline.moves import Approach, Close, GoTo, Grasp, Grip, MoveTo, Release, Retreat
from minidual.skills.pipeline.search import Task
from minidual.skills.pipeline.state import TaskObject

_ALONG_Y = (float(np.sqrt(0.5)), -float(np.sqrt(0.5)), 0.0, 0.0)
_ACROSS = rot_z(np.pi / 2.0) @ rot_x(np.pi)
"""A hand that points down with its fingers across the rod."""
OFFSETS_M = (0.12, 0.10, 0.08)
LEANS_RAD = (0.0, 0.25, -0.25)
HEIGHT_M = 0.003


def rod_object(length_m: float, radius_m: float) -> TaskObject:
    """Return a rod along its own y axis, its ends rounded inside its length."""
    return TaskObject(Capsule("rod", (0.0, 0.0, 0.0), _ALONG_Y, radius_m=radius_m, length_m=length_m - 2.0 * radius_m))


def rod_grasp(offset_m: float, lean_rad: float = 0.0, *, turned: bool = False) -> Array:
    """Return T_rod_tcp (4, 4) of a hand on the rod.

    Args:
        offset_m: Along the rod from its centre.
        lean_rad: Of the hand about the rod, away from straight down.
        turned: Whether the hand is turned half round, its fingers exchanged.
    """
    lean = np.eye(3)
    lean[np.ix_([0, 2], [0, 2])] = [[np.cos(lean_rad), np.sin(lean_rad)], [-np.sin(lean_rad), np.cos(lean_rad)]]
    rotation = lean @ _ACROSS @ (rot_z(np.pi) if turned else np.eye(3))
    return pose(rotation, lean @ np.array([0.0, 0.0, HEIGHT_M]) + np.array([0.0, offset_m, 0.0]))


def both_hand_grips(offsets_m: Sequence[float] = OFFSETS_M, leans_rad: Sequence[float] = LEANS_RAD) -> tuple[Grip, ...]:
    """Return grips of both hands, the left one at the +y end: the widest and upright ones are preferred."""
    grips = []
    for (i, offset), (j, lean), turned in itertools.product(enumerate(offsets_m), enumerate(leans_rad), (False, True)):
        grasps = {
            arm: rod_grasp(side * offset, lean, turned=turned) for arm, side in zip(ARMS, (1.0, -1.0), strict=True)
        }
        label = f"{offset * 100:.0f} cm from the centre, lean {lean:+.2f} rad{', turned' if turned else ''}"
        grips.append(Grip(label, grasps, cost=float(i + j + 0.5 * turned)))
    return tuple(grips)


def one_hand_grips(
    arm: str, offsets_m: Sequence[float] = (0.0, 0.03, -0.03), leans_rad: Sequence[float] = LEANS_RAD
) -> tuple[Grip, ...]:
    """Return grips of one hand near the rod's centre."""
    return tuple(
        Grip(
            f"{offset * 100:+.0f} cm, lean {lean:+.2f} rad{', turned' if turned else ''}",
            {arm: rod_grasp(offset, lean, turned=turned)},
            cost=float(i + j + 0.5 * turned),
        )
        for (i, offset), (j, lean), turned in itertools.product(
            enumerate(offsets_m), enumerate(leans_rad), (False, True)
        )
    )


def carry_task(
    grips: Sequence[Grip], places: Sequence[Place], *, q_end: Array = HOME, name: str = "carry the rod"
) -> Task:
    """Return the task: fetch the object by one of the grips, put it down at one of the places, go to q_end (14,)."""
    arms = tuple(arm for arm in ARMS if arm in grips[0].grasps)
    return Task(
        name,
        [
            MoveTo("move_to"),
            Approach("approach", arms),
            Grasp("grasp", grips),
            Close("close", arms),
            ChoosePlace("place_pose", places),
            Lift("lift"),
            Transport("transport"),
            PutDown("place"),
            Release("release", arms),
            Retreat("retreat", arms),
            MoveTo("move_back"),
            GoTo("end", q_end),
        ],
    )


def handover_task(
    first: str,
    grips_first: Sequence[Grip],
    grips_second: Sequence[Grip],
    meetings: Sequence[Place],
    places: Sequence[Place],
    *,
    q_end: Array = HOME,
) -> Task:
    """Return the task: one hand fetches the object, the other takes it from it in the air and puts it down.

    Args:
        first: Arm that fetches.
        grips_first: Its grips.
        grips_second: Grips of the other hand, which must leave room for the first.
        meetings: Poses of the object in the air at which it changes hands.
        places: Where it is put down.
        q_end: Configuration (14,) [rad] to which each arm goes back.
    """
    second = "right" if first == "left" else "left"
    return Task(
        f"hand the rod from {first} to {second}",
        [
            MoveTo("move_to"),
            Approach("approach", (first,)),
            Grasp("grasp", grips_first),
            Close("close", (first,)),
            Lift("lift"),
            ChoosePlace("meeting", meetings),
            Transport("to_meeting", heights_m=(0.0,)),
            MoveTo("second_move_to"),
            Approach("second_approach", (second,)),
            Grasp("second_grasp", grips_second),
            Close("second_close", (second,)),
            Release("let_go", (first,)),
            Retreat("first_retreat", (first,)),
            MoveTo("first_back"),
            GoTo("first_end", q_end, (first,)),
            ChoosePlace("place_pose", places),
            Transport("transport"),
            PutDown("place"),
            Release("release", (second,)),
            Retreat("retreat", (second,)),
            MoveTo("move_back"),
            GoTo("end", q_end),
        ],
    )
