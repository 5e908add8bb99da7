"""Conditions of a trial: pushes, changed mass, friction or light, worse sensing.

Methods are not told. Other distributions add rows (docs/howto-condition.md).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from pydantic import ValidationError

from minidual.config.root import Config, changed
from minidual.config.scene import DISTRACTOR_HALF_M, DISTRACTORS, ObstacleConfig
from minidual.errors import UsageError, unknown_name
from minidual.registry import Registry, rows_beside
from minidual.robot.pair import Array
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, beside, placement
from minidual.trials.methods import METHODS, SENSES

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    import mujoco

    from minidual.demos.rig import Room
    from minidual.plant.world import World

CLEAN = "clean"
_HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE: arm joints; fingers slide
ALL = "all"
_RISEN_M = 0.05  # before a push
_DELAY_S = (0.2, 1.2)  # from rise to push
_ALOFT_M = 0.01  # lower, the table may take up part of the push
DRY_NM = 0.36
"""Coulomb friction of a Panda's joint, mean of seven: half of phi_1 (0.30 to 1.28 Nm) in Gaz et al., IEEE RA-L 4(4),
2019."""
_SHADE = (0.6, 1.4)  # factors of an object's colour
OBJECT_COLOURS = (
    (0.78, 0.12, 0.12),
    (0.15, 0.55, 0.20),
    (0.50, 0.18, 0.60),
    (0.10, 0.65, 0.70),
    (0.88, 0.88, 0.86),
)
TABLE_COLOURS = (
    (0.60, 0.45, 0.30),
    (0.85, 0.85, 0.83),
    (0.18, 0.18, 0.20),
    (0.35, 0.50, 0.38),
    (0.28, 0.38, 0.56),
)
"""Discrete, unlike the trainer's augmentation."""
_BESIDE_M = (0.64, -0.35), (0.80, 0.35)  # range of the distractors' places (x, y)
_DRAWS_MAX = 100
_MOVED_AT_S = 0.5  # the hands have left home and are not yet near


class Disturbance(Protocol):
    """Acts on the world after every step."""

    took_place: bool
    """Whether it has acted completely."""

    def __call__(self, world: World) -> None:
        """Act or wait."""


Change = Callable[["mujoco.MjModel", Task, Trial, np.random.Generator], None]
"""Changes the compiled model."""
Amount = float | tuple[float, float]
"""A number, or the least and largest value of a draw."""


@dataclass(frozen=True)
class Condition:
    """One row of conditions.yaml.

    Attributes:
        act: Makes the disturbance of a trial.
        instead_of: What `change` sets, {dotted path: value}.
        settings: Sets {dotted path: value}.
        factors: Scales {dotted path: factor}.
        sense: Row of SENSES that it changes; empty for the plant.
        widen: Scales the range of the start.
        promised: Whether a carry must pass it.
    """

    name: str
    summary: str
    act: Callable[[Task, np.random.Generator], Disturbance] | None = None
    change: Change | None = None
    instead_of: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    sense: str = ""
    widen: float = 1.0
    promised: bool = True

    def why_not(self, method: str, config: Config) -> str:
        """Return why it does not apply, or an empty string."""
        if self.sense and self.sense not in METHODS[method].reads(make_task(config)):
            return f"{method} reads no {SENSES[self.sense]}"
        values = {**self.instead_of, **self.settings_under(config)}
        told = self.change is None or self.instead_of
        if (
            told
            and values
            and all(value == attrgetter(path)(config) for path, value in values.items())
        ):
            return "without it too, " + ", ".join(
                f"{path} is {value:g}" for path, value in values.items()
            )
        return ""

    def settings_under(self, config: Config) -> dict[str, float]:
        """Return its changes of `config`."""
        return {
            **self.settings,
            **{path: k * attrgetter(path)(config) for path, k in self.factors.items()},
        }

    def config_under(self, config: Config) -> Config:
        """Return the configuration of its trials.

        Raises:
            UsageError: A value is out of bounds.
        """
        values = self.settings_under(config)
        try:
            return changed(config, values)
        except ValidationError as error:
            told = ", ".join(f"{path} = {value:g}" for path, value in values.items())
            refused = f"condition '{self.name}' sets {told}: {error.errors()[0]['msg']}"
            raise UsageError(
                refused,
                remedy="leave the condition out, or configure less noise",
            ) from error

    @contextmanager
    def applied(
        self,
        model: mujoco.MjModel,
        task: Task,
        trial: Trial,
        rng: np.random.Generator,
    ) -> Generator[None]:
        """Change a model, then restore it."""
        if self.change is None:
            yield
            return
        fields = (
            getattr(of, n)
            for of in (model, model.vis.headlight)
            for n in dir(of)
            if not n.startswith("_")
        )
        kept = [(values, values.copy()) for values in fields if isinstance(values, np.ndarray)]
        try:
            self.change(model, task, trial, rng)  # inside try: a partial change must be undone too
            _derive(model)
            yield
        finally:
            for values, before in kept:
                values[...] = before
            _derive(model)


def _derive(model: mujoco.MjModel) -> None:
    import mujoco

    mujoco.mj_setConst(model, mujoco.MjData(model))


def _drawn(rng: np.random.Generator, amount: Amount) -> float:
    return amount if isinstance(amount, float | int) else float(rng.uniform(*amount))


def mass(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale the mass and inertia of every object."""
    for name in task.objects:
        body = model.body(name).id
        scale = _drawn(rng, factor)
        model.body_mass[body] *= scale
        model.body_inertia[body] *= scale


def size(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale all objects alike, so that parts still fit, about where they stand; frames and centres of mass stay."""
    scale = _drawn(rng, factor)
    for name in task.objects:
        body = model.body(name)
        where = trial.start[name]
        upright = (task.objects[name].body.rest_height_m, np.eye(3)[2])
        height_m, up = upright if isinstance(where, tuple) else (where[2, 3], where[2, :3])
        geoms = model.geom_bodyid == body.id
        model.geom_pos[geoms] = scale * model.geom_pos[geoms] + (scale - 1.0) * height_m * up
        for values in (model.geom_size, model.geom_rbound, model.geom_aabb):
            values[geoms] *= scale
        boxes = slice(
            model.body_bvhadr[body.id],
            model.body_bvhadr[body.id] + model.body_bvhnum[body.id],
        )
        model.bvh_aabb[boxes, 3:] += 0.1  # too large a box loses no contact


def friction(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    value: float,
) -> None:
    """Set friction of objects, pads and table."""
    model.geom_friction[_touching(model, task), 0] = value


def slip(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale the same friction."""
    model.geom_friction[_touching(model, task), 0] *= _drawn(rng, factor)


def _touching(model: mujoco.MjModel, task: Task) -> list[int]:
    """Return the geoms of objects, pads and table: MuJoCo takes the larger friction of two, so all must change."""
    objects = {int(model.body(name).id) for name in task.objects}
    named = ((i, model.geom(i).name) for i in range(model.ngeom))
    return [
        i
        for i, n in named
        if n.endswith("_pad") or n == "table_top" or int(model.geom_bodyid[i]) in objects
    ]


def joint_friction(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
    every: bool = False,
) -> None:
    """Scale the friction of every joint, or of one, another each trial; no dry friction counts as `DRY_NM`."""
    hinges = np.flatnonzero(model.jnt_type == _HINGE).tolist()
    for hinge in hinges if every else [hinges[trial.index % len(hinges)]]:
        joint = model.joint(hinge)
        scale = _drawn(rng, factor)
        joint.damping[0] *= scale
        joint.frictionloss[0] = scale * (joint.frictionloss[0] or DRY_NM)


def light(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale every light."""
    lamp = model.vis.headlight
    scale = _drawn(rng, factor)
    for values in (
        model.light_diffuse,
        model.light_specular,
        lamp.ambient,
        lamp.diffuse,
        lamp.specular,
    ):
        values *= scale


def camera_moved(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    distance_m: Amount,
    angle_rad: Amount,
) -> None:
    """Shift and turn every camera of the room in a random direction."""
    import mujoco

    shift_m = _drawn(rng, distance_m)
    half_rad = _drawn(rng, angle_rad) / 2.0
    for camera in np.flatnonzero(model.cam_bodyid == 0):
        way, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        model.cam_pos[camera] += shift_m * way
        turn = np.r_[np.cos(half_rad), np.sin(half_rad) * axis]
        mujoco.mju_mulQuat(model.cam_quat[camera], turn, model.cam_quat[camera].copy())


def object_colour(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
) -> None:
    """Paint an object, not its bands; of several, change the shades."""
    if len(task.objects) == 1:
        model.geom(task.carried).rgba[:3] = OBJECT_COLOURS[rng.integers(len(OBJECT_COLOURS))]
        return
    for name in task.objects:
        rgba = model.geom(name).rgba
        rgba[:3] = np.minimum(1.0, rgba[:3] * rng.uniform(*_SHADE, 3))


def object_hidden(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
) -> None:
    """Make the objects invisible."""
    for name in task.objects:
        model.geom_rgba[model.geom_bodyid == model.body(name).id, 3] = 0.0


def table_colour(model: mujoco.MjModel, task: Task, trial: Trial, rng: np.random.Generator) -> None:
    """Paint the table."""
    model.geom("table_top").rgba[:3] = TABLE_COLOURS[rng.integers(len(TABLE_COLOURS))]


def distractors(model: mujoco.MjModel, task: Task, trial: Trial, rng: np.random.Generator) -> None:
    """Put the distractors before the camera, away from starts and goals."""
    size = 2.0 * DISTRACTOR_HALF_M
    places = [(n, placement(T)) for poses in (trial.start, trial.goal) for n, T in poses.items()]
    for name in DISTRACTORS:
        thing = model.geom(name)
        yaw = rng.uniform(-np.pi, np.pi)
        for _ in range(_DRAWS_MAX):
            x, y = rng.uniform(*_BESIDE_M).tolist()
            block = ObstacleConfig(size_m=(size, size, size), xy_m=(x, y))
            if all(beside(task.objects[n].body, block, place) for n, place in places):
                break
        thing.pos[:] = x, y, DISTRACTOR_HALF_M
        thing.quat[:] = np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)
        thing.rgba[:] = *OBJECT_COLOURS[rng.integers(len(OBJECT_COLOURS))], 1.0


def _in_turn(
    each: Sequence[Change],
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
) -> None:
    for change in each:
        change(model, task, trial, rng)


class Push:
    """One ramped force on the carried object's centre of mass, at a random time after it has risen."""

    duration_s = 0.2
    ramp_s = 0.02
    delays_s = _DELAY_S

    def __init__(self, task: Task, rng: np.random.Generator, *, force_n: Sequence[float]) -> None:
        self._force = np.array(force_n, dtype=float)
        self._name = task.carried
        self._delay_s = float(rng.uniform(*self.delays_s))
        # without a ramp 20 N on 0.2 kg throws a rigid object off the pads
        self.length_s = self.duration_s + 2.0 * self.ramp_s
        self._rest_m: float | None = None
        self._risen_s = np.inf
        self._aloft = True
        self.took_place = False

    def at(self, t_s: float) -> Array:
        """Return the force (3,) [N] at a time since its start."""
        return np.clip(min(t_s, self.length_s - t_s) / self.ramp_s, 0.0, 1.0) * self._force

    def __call__(self, world: World) -> None:
        """Act or wait."""
        body = world.truth(self._name).body
        height = float(world.data.xpos[body, 2])
        self._rest_m = height if self._rest_m is None else self._rest_m
        risen_m = height - self._rest_m
        if risen_m > _RISEN_M:
            self._risen_s = min(self._risen_s, world.time)
        since = world.time - self._risen_s - self._delay_s
        world.data.xfrc_applied[body, :3] = self.at(since)
        if 0.0 <= since < self.length_s:
            self._aloft = self._aloft and risen_m > _ALOFT_M
        elif since >= self.length_s:
            self.took_place = self._aloft


class Move:
    """Shifts the carried object once along the table, in a random direction."""

    def __init__(self, task: Task, rng: np.random.Generator, *, distance_m: float) -> None:
        direction = float(rng.uniform(0.0, 2.0 * np.pi))
        self._by = distance_m * np.array([np.cos(direction), np.sin(direction)])
        self._name = task.carried
        self.took_place = False

    def __call__(self, world: World) -> None:
        """Act or wait."""
        if not self.took_place and world.time >= _MOVED_AT_S:
            world.truth(self._name).qpos[:2] += self._by
            self.took_place = True


_MADE: dict[str, Callable[..., Disturbance]] = {"push": Push, "move": Move}
_CHANGED = (
    mass,
    size,
    friction,
    slip,
    joint_friction,
    light,
    camera_moved,
    object_colour,
    table_colour,
    object_hidden,
)
_CHANGES: dict[str, Callable[..., None]] = {f.__name__: f for f in (*_CHANGED, distractors)}

CONDITIONS: Registry[Condition] = Registry("condition", group="minidual.conditions")
for _name, _row in rows_beside(__file__).items():
    for _function, _arguments in _row.get("act", {}).items():
        _row["act"] = partial(_MADE[_function], **_arguments)
    if "change" in _row:
        _row["change"] = partial(
            _in_turn,
            [partial(_CHANGES[f], **given) for f, given in _row["change"].items()],
        )
    CONDITIONS.add(_name, Condition(_name, **_row))


def condition(name: str) -> Condition:
    """Return a condition; blanks may be underscores or omitted."""
    short = name.replace(" ", "").replace("_", "")
    if (
        known := next((n for n in CONDITIONS if n.replace(" ", "").replace("_", "") == short), None)
    ) is None:
        raise unknown_name("condition", name, CONDITIONS)
    return CONDITIONS[known]


def rooms(names: Sequence[str]) -> tuple[Room, ...]:
    """Return conditions under which demonstrations can be recorded.

    Raises:
        UsageError: Unknown name, or a condition that does more than change the model.
    """
    chosen = tuple(condition(name) for name in names)
    for row in chosen:
        if row.name != CLEAN and row.change is None:
            known = ", ".join(n for n, other in CONDITIONS.items() if n == CLEAN or other.change)
            raise UsageError(
                f"demonstrations cannot be recorded under '{row.name}'; there are {known}",
            )
    return tuple((row.name, row.applied) for row in chosen)


def parse_conditions(given: Sequence[str]) -> tuple[str, ...]:
    """Return the full names, `clean` first; `all` stands for every condition.

    Raises:
        UsageError: Unknown or repeated name, or no `clean`.
    """
    if list(given) == [ALL]:
        return tuple(CONDITIONS)
    if ALL in given:
        raise UsageError(
            f"'{ALL}' stands for every condition; leave out the others of {', '.join(given)}",
        )
    names = CONDITIONS.names([condition(name).name for name in given])
    if CLEAN not in names:
        remedy = "--conditions " + ",".join(name.replace(" ", "_") for name in (CLEAN, *names))
        why = "the limits hold there, and every loss is counted from it"
        raise UsageError(f"the conditions {', '.join(names)} lack '{CLEAN}': {why}", remedy=remedy)
    return (CLEAN, *(n for n in names if n != CLEAN))
