"""Move a demonstration to another start and goal."""

import numpy as np

from minidual.control.kernels import minimum_jerk
from minidual.demos.augment.segments import SourceDemo
from minidual.motion.ik import posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, pose, rot_z
from minidual.skills.operator import Demonstration
from minidual.tasks.task import Placement

_TRAVEL_MIN_M = 0.02
"""An object that is carried less far has its progress by time."""


def moved(
    source: SourceDemo,
    start: Placement,
    goal: Placement,
    kinematics: Kinematics,
    symmetry: int = 1,
) -> Demonstration:
    """Return the demonstration as it would be for another start and goal.

    While both hands hold the object, one rigid motion moves both: their grasps stay as they were.

    Args:
        source: What was recorded.
        start: Of the object.
        goal: Of the object.
        kinematics: Of the arms.
        symmetry: Yaws of the object that look alike in a turn.

    Raises:
        PoseUnreachableError: A hand cannot reach a moved pose.
    """
    robot = kinematics.robot
    hands = moved_hands(source, start, goal, symmetry)
    q = np.empty_like(source.q)
    posture = source.q[0].copy()
    for tick in range(len(q)):
        posture = posture_at(robot, hands[tick], posture, source.q[tick])
        q[tick] = posture
    return Demonstration(source.rate_hz, q, source.gripper)


def moved_hands(
    source: SourceDemo,
    start: Placement,
    goal: Placement,
    symmetry: int = 1,
) -> Array:
    """Return T_world_tcp (T, 2, 4, 4) of the moved demonstration; arguments as in `moved`."""
    shift_start = _shift(source.start, start, symmetry)
    shift_goal = _shift(source.goal, goal, symmetry)
    carried = carried_path(source)
    progress = carry_progress(source, carried)
    hands = np.empty_like(source.hands)
    for tick in range(len(hands)):
        for side in range(len(SIDES)):
            if tick < source.held:
                share, _, _ = minimum_jerk(tick / source.near[side])
                place = carried[0]
                shift = share * shift_start
            else:
                k = min(tick, source.released) - source.held
                place = carried[k]
                shift = (1.0 - progress[k]) * shift_start + progress[k] * shift_goal
            hands[tick, side] = _between(place, place + shift) @ source.hands[tick, side]
    return hands


def carried_path(source: SourceDemo) -> Array:
    """Return where the hands carry the object, (x, y, yaw), from `held` to `released`."""
    grips = source.hands[source.held : source.released + 1]
    middle = grips[:, :, :2, 3].mean(axis=1)
    across = grips[:, 0, :2, 3] - grips[:, 1, :2, 3]
    yaw = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    turned = yaw - yaw[0]
    offset = np.array(source.start[:2]) - middle[0]
    cos = np.cos(turned)
    sin = np.sin(turned)
    x = middle[:, 0] + cos * offset[0] - sin * offset[1]
    y = middle[:, 1] + sin * offset[0] + cos * offset[1]
    return np.column_stack([x, y, source.start[2] + turned])


def carry_progress(source: SourceDemo, carried: Array) -> Array:
    """Return how far the object is from its start to where it is released, 0 to 1.

    By its way along the straight line, so that it is not moved while it stands on the table.
    """
    travel = carried[-1, :2] - carried[0, :2]
    distance_m = float(np.linalg.norm(travel))
    if distance_m < _TRAVEL_MIN_M:
        times = np.linspace(0.0, 1.0, len(carried))
        return np.array([minimum_jerk(t)[0] for t in times.tolist()])
    along = (carried[:, :2] - carried[0, :2]) @ travel / distance_m**2
    return np.clip(along, 0.0, 1.0)


def distance(source: SourceDemo, start: Placement, goal: Placement, symmetry: int) -> float:
    """Return how far a demonstration is from another start and goal [m]; a radian counts 0.2 m."""
    scale = np.array([1.0, 1.0, 0.2])
    shifts = _shift(source.start, start, symmetry), _shift(source.goal, goal, symmetry)
    return sum(float(np.linalg.norm(scale * shift)) for shift in shifts)


def _shift(first: Placement, second: Placement, symmetry: int) -> Array:
    """Return second - first, the yaw by the shortest turn to one that looks alike."""
    period = 2.0 * np.pi / symmetry
    turn = second[2] - first[2]
    turn -= period * np.round(turn / period)
    return np.array([second[0] - first[0], second[1] - first[1], turn])


def _between(first: Array, second: Array) -> Array:
    """Return the motion (4, 4) in the plane that takes an object from one place to another."""
    return _planar(second) @ np.linalg.inv(_planar(first))


def _planar(place: Array) -> Array:
    return pose(rot_z(place[2]), (place[0], place[1], 0.0))
