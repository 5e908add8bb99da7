"""The table of conditions: pushes, changed mass, friction or light, worse sensing.

Methods are not told. Other distributions add rows through the entry point group
`minidual.conditions` (docs/howto-condition.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from minidual.errors import UsageError, unknown_name
from minidual.registry import Registry
from minidual.trials.changes import (
    camera_moved,
    distractors,
    friction,
    in_turn,
    joint_friction,
    light,
    mass,
    object_colour,
    object_hidden,
    size,
    slip,
    table_colour,
)
from minidual.trials.condition import Condition
from minidual.trials.disturbances import Move, Push

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    from minidual.demos.rig import Room

CLEAN = "clean"
ALL = "all"
_PUSH_N = 20.0
_DARK = 0.7
_BRIGHT = 1.4
_CAMERA_M = 0.02
_CAMERA_RAD = 0.05235987755982989  # 3 degrees
_MASSES = (0.5, 1.5)


def _push(axis: str, x: float, y: float, z: float) -> Condition:
    return Condition(
        f"push {axis}",
        f"{_PUSH_N:.0f} N along {axis} for 0.2 s while the object is in the air",
        act=partial(Push, force_n=(_PUSH_N * x, _PUSH_N * y, _PUSH_N * z)),
    )


_ROWS = (
    Condition(CLEAN, "nothing disturbs the trial"),
    _push("+x", 1.0, 0.0, 0.0),
    _push("-x", -1.0, 0.0, 0.0),
    _push("+y", 0.0, 1.0, 0.0),
    _push("-y", 0.0, -1.0, 0.0),
    _push("+z", 0.0, 0.0, 1.0),
    _push("-z", 0.0, 0.0, -1.0),
    Condition(
        "moved 20 mm",
        "somebody moves the object 20 mm along the table while the hands approach",
        act=partial(Move, distance_m=0.020),
    ),
    Condition(
        "mass -50 %",
        "an object of half the mass that is expected",
        change=partial(mass, factor=0.5),
    ),
    Condition(
        "mass +50 %",
        "an object of one and a half times the mass that is expected",
        change=partial(mass, factor=1.5),
    ),
    Condition(
        "friction 0.3",
        "pads, object and table have friction 0.3, which nobody is told",
        change=partial(friction, value=0.3),
        instead_of={"scene.object.friction": 0.3},
    ),
    Condition(
        "friction 0.7",
        "pads, object and table have friction 0.7, which nobody is told",
        change=partial(friction, value=0.7),
        instead_of={"scene.object.friction": 0.7},
    ),
    Condition(
        "pose noise x3",
        "the camera sees the object three times as badly",
        factors={"carry.sensing.pose_noise_m": 3.0, "carry.sensing.pose_noise_rad": 3.0},
        sense="pose",
    ),
    Condition(
        "delay 20 ms",
        "pose and forces arrive 20 ms late",
        settings={"carry.sensing.delay_s": 0.020},
        sense="feedback",
    ),
    Condition(
        "light -30 %",
        "the cameras look at a darker room",
        change=partial(light, factor=_DARK),
        sense="picture",
    ),
    Condition(
        "light +40 %",
        "the cameras look at a brighter room",
        change=partial(light, factor=_BRIGHT),
        sense="picture",
        promised=False,
    ),
    Condition(
        "camera moved",
        "the camera stands 20 mm and 3 degrees off",
        change=partial(camera_moved, distance_m=_CAMERA_M, angle_rad=_CAMERA_RAD),
        sense="picture",
        promised=False,
    ),
    Condition(
        "object colour",
        "an object of another colour",
        change=object_colour,
        sense="picture",
        promised=False,
    ),
    Condition(
        "table colour",
        "a table of another colour",
        change=table_colour,
        sense="picture",
        promised=False,
    ),
    Condition(
        "object hidden",
        "an object that no camera sees: a policy that looks must fail",
        change=object_hidden,
        sense="picture",
        promised=False,
    ),
    Condition(
        "distractors",
        "two more things on the table",
        change=distractors,
        sense="picture",
        promised=False,
    ),
    Condition(
        "room",
        "light of 0.7 to 1.4, camera, colours and distractors at once",
        change=in_turn(
            partial(light, factor=(_DARK, _BRIGHT)),
            partial(camera_moved, distance_m=_CAMERA_M, angle_rad=_CAMERA_RAD),
            object_colour,
            table_colour,
            distractors,
        ),
        sense="picture",
        promised=False,
    ),
    Condition(
        "unseen object",
        "an object of 0.85 to 1.15 of the size, another mass, friction and colour,"
        " which nobody is told",
        change=in_turn(
            partial(size, factor=(0.85, 1.15)),
            partial(mass, factor=_MASSES),
            partial(slip, factor=(0.7, 1.3)),
            object_colour,
        ),
        promised=False,
    ),
    Condition(
        "start range x1.5",
        "an object that starts anywhere in a larger area",
        widen=1.5,
        promised=False,
    ),
    Condition(
        "joint friction x2",
        "one joint, another each trial, with twice a real joint's dry friction (0.72 Nm)",
        change=partial(joint_friction, factor=2.0),
    ),
    Condition(
        "randomised",
        "room and plant at once: light, camera, colours, distractors, masses, friction,"
        " every joint's friction and the pose sensor's offset, drawn for each trial",
        change=in_turn(
            partial(light, factor=(_DARK, _BRIGHT)),
            partial(camera_moved, distance_m=(0.0, _CAMERA_M), angle_rad=(0.0, _CAMERA_RAD)),
            object_colour,
            table_colour,
            distractors,
            partial(mass, factor=_MASSES),
            partial(slip, factor=(0.4, 1.3)),
            partial(joint_friction, factor=(0.5, 1.5), every=True),
        ),
        # Standard deviation of each coordinate.
        settings={"carry.sensing.pose_bias_m": 0.010, "carry.sensing.pose_bias_rad": 0.03},
        promised=False,
    ),
)
CONDITIONS: Registry[Condition] = Registry("condition", group="minidual.conditions")
for _row in _ROWS:
    CONDITIONS.add(_row.name, _row)


def condition(name: str) -> Condition:
    """Return a condition; blanks may be underscores or omitted.

    Raises:
        UsageError: Unknown name.
    """
    for row_name in CONDITIONS:
        if _short(row_name) == _short(name):
            return CONDITIONS[row_name]
    raise unknown_name("condition", name, CONDITIONS)


def _short(name: str) -> str:
    return name.replace(" ", "").replace("_", "")


def rooms(names: Sequence[str]) -> tuple[Room, ...]:
    """Return conditions under which demonstrations can be recorded.

    Raises:
        UsageError: Unknown name, or a condition that does more than change the model.
    """
    chosen = tuple(condition(name) for name in names)
    for row in chosen:
        if row.name != CLEAN and row.change is None:
            recordable = [n for n, other in CONDITIONS.items() if n == CLEAN or other.change]
            raise UsageError(
                f"demonstrations cannot be recorded under '{row.name}'; there are"
                f" {', '.join(recordable)}",
            )
    return tuple((row.name, row.applied) for row in chosen)


def parse_conditions(typed: Sequence[str]) -> tuple[str, ...]:
    """Return the full names, `clean` first; `all` stands for every condition.

    Raises:
        UsageError: Unknown or repeated name, or no `clean`.
    """
    if list(typed) == [ALL]:
        return tuple(CONDITIONS)
    if ALL in typed:
        raise UsageError(
            f"'{ALL}' stands for every condition; leave out the others of {', '.join(typed)}",
        )
    names = CONDITIONS.names([condition(name).name for name in typed])
    if CLEAN not in names:
        option = ",".join(name.replace(" ", "_") for name in (CLEAN, *names))
        reason = "the limits hold there, and every loss is counted from it"
        raise UsageError(
            f"the conditions {', '.join(names)} lack '{CLEAN}': {reason}",
            remedy=f"--conditions {option}",
        )
    return (CLEAN, *(name for name in names if name != CLEAN))
