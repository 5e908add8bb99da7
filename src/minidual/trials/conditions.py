"""What the world does to a trial: pushes, another mass, another friction, worse sensing. One table, the clean one first.

A condition changes the plant and the sensors; the method is told nothing of it. The rod that is 50 % heavier is still
the 0.2 kg rod to whoever carries it. One thing is known: samples carry their time stamp, so whoever uses it (the pose
estimate of the carry does) allows for the age of a late pose. What changes the plant touches every method; what changes a sensor touches those
that read it, and a method that does not is not run under it: the trials would be the clean ones under another name.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import mujoco
import numpy as np
from pydantic import ValidationError

from minidual.config.change import changed
from minidual.config.root import Config
from minidual.errors import UsageError, unknown_name
from minidual.plant.bodies import object_names
from minidual.plant.world import World
from minidual.robot.pair import Array

CLEAN = "clean"
ALL = "all"
SENSES: dict[str, str] = {
    "pose": "sensed pose of the object",
    "feedback": "pose or contact force during the motion",
    "picture": "picture",
}
"""What a method may read of the object, and what it is called in a sentence; joints are read by all."""
_RISEN_M = 0.05
"""A push comes while the object is in the air: it waits until the object has risen this far ..."""
_DELAY_S = (0.2, 1.2)
"""... and then for a time drawn from this range."""
_ALOFT_M = 0.01
"""An object pushed lower than this above where it lay may stand on the table, which takes the push for the hands."""
_MOVED_AT_S = 0.5
"""An object is moved while the hands approach: they have set out, and none is near it yet."""


class Disturbance(Protocol):
    """What acts on the world after every step of one trial."""

    @property
    def took_place(self) -> bool:
        """Whether it has acted, wholly and as its condition says."""
        ...

    def __call__(self, world: World) -> None:
        """Act on the world, or wait."""
        ...


@dataclass(frozen=True)
class Push:
    """A force on the object's centre of mass, world axes: full for `duration_s`, with a ramp before and after.

    Without the ramps it would be a blow: 20 N on 0.2 kg from one millisecond to the next throws a rigid object off
    the pad for an instant, which no hand, tool or wall with some give does.
    """

    force_n: tuple[float, float, float]
    duration_s: float = 0.2
    ramp_s: float = 0.02

    @property
    def length_s(self) -> float:
        """Time from its first to its last force."""
        return self.duration_s + 2.0 * self.ramp_s

    def at(self, t_s: float) -> Array:
        """Return the force (3,) [N] at a time after the push began."""
        left = self.length_s - t_s
        share = min(1.0, max(0.0, min(t_s, left) / self.ramp_s))
        return share * np.array(self.force_n)


@dataclass(frozen=True)
class Condition:
    """One row of the table.

    Attributes:
        name: As in tables and trials.
        summary: One line for people.
        push: Force while the object is in the air.
        move_m: How far somebody moves the object along the table, in a direction of each trial's own.
        mass_factor: Of the object's mass and inertia.
        friction: Of object, pads and table, in place of the configured one.
        joint_friction_factor: Viscous and Coulomb friction of one joint, another one each trial.
        light_factor: Of every light, as the cameras see it.
        settings: Configuration values {dotted path: value} under which the trial runs, for the sensors.
        factors: Of configured values {dotted path: factor}, for the sensors too.
        sense: Row of SENSES that it changes and nothing else does; empty if it changes the plant, which no method
            escapes.
        promised: Whether a carry must hold it. One that is not is compared, and measured by no limit.
    """

    name: str
    summary: str
    push: Push | None = None
    move_m: float = 0.0
    mass_factor: float = 1.0
    friction: float | None = None
    joint_friction_factor: float = 1.0
    light_factor: float = 1.0
    settings: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    sense: str = ""
    promised: bool = True

    @property
    def key(self) -> str:
        """The name without blanks, for checks and files."""
        return self.name.replace(" ", "_")

    def why_not(self, method: str, senses: Collection[str]) -> str:
        """Return why it cannot touch a method that reads `senses` (rows of SENSES), or an empty string if it can."""
        return "" if not self.sense or self.sense in senses else f"{method} reads no {SENSES[self.sense]}"

    def settings_under(self, config: Config) -> dict[str, float]:
        """Return the configuration values {dotted path: value} of its trials, where `config` is that of the clean ones."""
        return {**self.settings, **{path: k * _configured(config, path) for path, k in self.factors.items()}}

    def config_under(self, config: Config) -> Config:
        """Return the configuration of its trials.

        Raises:
            UsageError: Its values are out of their bounds, as three times a loud noise may be.
        """
        values = self.settings_under(config)
        try:
            return changed(config, values)
        except ValidationError as error:
            told = ", ".join(f"{path} = {value:g}" for path, value in values.items())
            raise UsageError(
                f"condition '{self.name}' sets {told}: {error.errors()[0]['msg']}",
                remedy="leave the condition out, or configure less noise",
            ) from error

    def same_as_clean(self, config: Config) -> str:
        """Return why its trials would be the clean ones under another name, or an empty string if they differ."""
        if self.friction is not None and self.friction == config.scene.rod.friction:
            return f"the friction is {self.friction:g} without it"
        values = self.settings_under(config)
        if values and all(value == _configured(config, path) for path, value in values.items()):
            return "without it too, " + ", ".join(f"{path} is {value:g}" for path, value in values.items())
        return ""

    @property
    def acts_once(self) -> bool:
        """Whether it is something that happens during a trial, and so may fail to happen."""
        return self.push is not None or self.move_m != 0.0

    @property
    def changes_the_plant(self) -> bool:
        """Whether the compiled model differs from the clean one."""
        return self.mass_factor != 1.0 or self.friction is not None or self.joint_friction_factor != 1.0

    @property
    def changes_the_model(self) -> bool:
        """Whether anything in the compiled model differs, light included."""
        return self.changes_the_plant or self.light_factor != 1.0

    @contextmanager
    def applied(self, model: mujoco.MjModel, index: int) -> Generator[None]:
        """Change a compiled model for trial `index`, and change it back; nothing else may hold it meanwhile."""
        if not self.changes_the_model:
            yield
            return
        kept = {name: np.array(getattr(model, name)) for name in _CHANGED}
        lamp = {name: np.array(getattr(model.vis.headlight, name)) for name in _LAMP}
        try:
            self._change(model, index)  # in here: one that breaks half way must not leave the rest to the next trial
            yield
        finally:
            for name, values in kept.items():
                getattr(model, name)[:] = values
            for name, values in lamp.items():
                getattr(model.vis.headlight, name)[:] = values
            _derive(model)

    def _change(self, model: mujoco.MjModel, index: int) -> None:
        rod = int(model.body(object_names(model)[0]).id)
        model.body_mass[rod] *= self.mass_factor
        model.body_inertia[rod] *= self.mass_factor
        if self.friction is not None:
            # MuJoCo takes the larger friction of the two geoms in contact, so all of them change.
            for i in range(model.ngeom):
                name = model.geom(i).name
                if int(model.geom_bodyid[i]) == rod or name.endswith("_pad") or name == "table_top":
                    model.geom_friction[i, 0] = self.friction
        hinges = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE))  # the arms', in storage order
        joint = model.joint(int(hinges[index % len(hinges)]))
        joint.damping[0] *= self.joint_friction_factor
        joint.frictionloss[0] *= self.joint_friction_factor
        model.light_diffuse *= self.light_factor
        model.light_specular *= self.light_factor
        for name in _LAMP:
            getattr(model.vis.headlight, name)[:] *= self.light_factor
        _derive(model)

    def disturbance(self, rng: np.random.Generator) -> Disturbance | None:
        """Return what acts on the world after every step of a trial, or None if nothing does."""
        if self.move_m:
            return _Mover(self.move_m, float(rng.uniform(0.0, 2.0 * np.pi)))
        return None if self.push is None else _Pusher(self.push, float(rng.uniform(*_DELAY_S)))


def _configured(config: Config, path: str) -> float:
    """Return the value at a dotted path."""
    found: Any = config
    for step in path.split("."):
        found = getattr(found, step)
    return float(found)


_CHANGED = (
    "body_mass",
    "body_inertia",
    "geom_friction",
    "dof_damping",
    "dof_frictionloss",
    "light_diffuse",
    "light_specular",
)
_LAMP = ("ambient", "diffuse", "specular")


def _derive(model: mujoco.MjModel) -> None:
    """Recompute what MuJoCo derives from masses: subtree masses and the weights that soften its constraints."""
    mujoco.mj_setConst(model, mujoco.MjData(model))


class _Pusher:
    """Pushes once. It reads the truth, as the hand of somebody who stands beside the table would."""

    def __init__(self, push: Push, delay_s: float) -> None:
        self._push, self._delay_s = push, delay_s
        self._rest_m: float | None = None
        self._risen_s: float | None = None
        self._aloft = True
        self.took_place = False

    def __call__(self, world: World) -> None:
        body = world.truth().body
        height = float(world.data.xpos[body, 2])
        if self._rest_m is None:
            self._rest_m = height
        if self._risen_s is None:
            if height - self._rest_m > _RISEN_M:
                self._risen_s = world.time
            return
        since = world.time - self._risen_s - self._delay_s
        world.data.xfrc_applied[body, :3] = self._push.at(since)
        if 0.0 <= since < self._push.length_s:
            self._aloft = self._aloft and height - self._rest_m > _ALOFT_M
        elif since >= self._push.length_s:
            self.took_place = self._aloft


class _Mover:
    """Moves the object once: it lies elsewhere from one step to the next, at rest, as high and turned as before."""

    def __init__(self, distance_m: float, direction_rad: float) -> None:
        self._by = distance_m * np.array([np.cos(direction_rad), np.sin(direction_rad)])
        self.took_place = False

    def __call__(self, world: World) -> None:
        if self.took_place or world.time < _MOVED_AT_S:
            return
        world.truth().qpos[:2] += self._by
        self.took_place = True


_PUSH_N = 20.0
_AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}

CONDITIONS: dict[str, Condition] = {
    c.name: c
    for c in (
        Condition(CLEAN, "nothing disturbs the trial"),
        *(
            Condition(
                f"push {axis}",
                f"{_PUSH_N:.0f} N along {axis} for 0.2 s while the object is in the air",
                push=Push((_PUSH_N * x, _PUSH_N * y, _PUSH_N * z)),
            )
            for axis, (x, y, z) in _AXES.items()
        ),
        Condition(
            "moved 20 mm",
            "somebody moves the object 20 mm along the table while the hands approach",
            move_m=0.020,
            promised=False,
        ),
        Condition("mass -50 %", "an object of half the mass that is expected", mass_factor=0.5),
        Condition("mass +50 %", "an object of one and a half times the mass that is expected", mass_factor=1.5),
        Condition("friction 0.3", "pads, object and table have friction 0.3, which nobody is told", friction=0.3),
        Condition("friction 0.7", "pads, object and table have friction 0.7, which nobody is told", friction=0.7),
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
        Condition("light -30 %", "the cameras look at a darker room", light_factor=0.7, sense="picture"),
        Condition(
            "joint friction x2", "one joint, another each trial, with doubled friction", joint_friction_factor=2.0
        ),
    )
}


_COMPACT = {name.replace(" ", ""): name for name in CONDITIONS}


def condition(name: str) -> Condition:
    """Return a condition by name, or say which exist; blanks may be underscores or be left out: mass_+50_%."""
    known = _COMPACT.get(name.replace(" ", "").replace("_", ""))
    if known is None:
        raise unknown_name("condition", name, CONDITIONS)
    return CONDITIONS[known]


def parse_conditions(text: str | Sequence[str]) -> tuple[str, ...]:
    """Return the conditions named in `clean,push +x,friction 0.3`, each once, the clean one first; `all` names all.

    Raises:
        UsageError: An unknown or repeated name, or `clean` is not among them: what a disturbance costs is counted from
            there.
    """
    typed = [n.strip() for n in (text.split(",") if isinstance(text, str) else text)]
    typed = [n for n in typed if n]
    if ALL in typed:
        if len(typed) > 1:
            raise UsageError(
                f"'{ALL}' stands for every condition, beside it stands {', '.join(n for n in typed if n != ALL)}"
            )
        return tuple(CONDITIONS)
    names = [condition(n).name for n in typed]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"condition '{name}' is named twice in {', '.join(typed)}")
    if CLEAN not in names:
        raise UsageError(
            f"the conditions {', '.join(typed) or '(none)'} lack '{CLEAN}': the limits hold there, and every loss is counted from it",
            remedy="--conditions " + ",".join([CLEAN, *(CONDITIONS[n].key for n in names)]),
        )
    return (CLEAN, *(n for n in names if n != CLEAN))
