"""What the world does to a trial: pushes, another mass, another friction, worse sensing. One table, the clean one first.

A condition changes the plant and the sensors; the method is told nothing of it. The rod that is 50 % heavier is still
the 0.2 kg rod to whoever carries it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import mujoco
import numpy as np

from minidual.errors import unknown_name
from minidual.robot.constants import DOF, JOINT_NAMES, Array
from minidual.sim.world import World

CLEAN = "clean"
_RISEN_M = 0.05
"""A push comes while the object is in the air: it waits until the object has risen this far ..."""
_DELAY_S = (0.2, 1.2)
"""... and then for a time drawn from this range."""


@dataclass(frozen=True)
class Push:
    """A force on the object's centre of mass, world axes: full for `duration_s`, with a ramp before and after.

    Without the ramps it would be a blow: 20 N on 0.2 kg from one millisecond to the next throws a rigid object off
    the pad for an instant, which no hand, tool or wall with some give does.
    """

    force_n: tuple[float, float, float]
    duration_s: float = 0.2
    ramp_s: float = 0.02

    def at(self, t_s: float) -> Array:
        """Return the force (3,) [N] at a time after the push began."""
        left = self.duration_s + 2.0 * self.ramp_s - t_s
        share = min(1.0, max(0.0, min(t_s, left) / self.ramp_s))
        return share * np.array(self.force_n)


@dataclass(frozen=True)
class Condition:
    """One row of the table.

    Attributes:
        name: As in tables and trials.
        summary: One line for people.
        push: Force while the object is in the air.
        mass_factor: Of the object's mass and inertia.
        friction: Of object, pads and table, in place of the configured one.
        joint_friction_factor: Viscous and Coulomb friction of one joint, another one each trial.
        settings: Configuration values {dotted path: value} under which the trial runs, for the sensors.
    """

    name: str
    summary: str
    push: Push | None = None
    mass_factor: float = 1.0
    friction: float | None = None
    joint_friction_factor: float = 1.0
    settings: Mapping[str, float] = field(default_factory=dict)

    @property
    def changes_the_plant(self) -> bool:
        """Whether the compiled model differs from the clean one."""
        return self.mass_factor != 1.0 or self.friction is not None or self.joint_friction_factor != 1.0

    @contextmanager
    def applied(self, model: mujoco.MjModel, index: int) -> Generator[None]:
        """Change a compiled model for trial `index`, and change it back; nothing else may hold it meanwhile."""
        if not self.changes_the_plant:
            yield
            return
        kept = {name: np.array(getattr(model, name)) for name in _CHANGED}
        self._change(model, index)
        try:
            yield
        finally:
            for name, values in kept.items():
                getattr(model, name)[:] = values
            _derive(model)

    def _change(self, model: mujoco.MjModel, index: int) -> None:
        rod = model.body("rod").id
        model.body_mass[rod] *= self.mass_factor
        model.body_inertia[rod] *= self.mass_factor
        if self.friction is not None:
            # MuJoCo takes the larger friction of the two geoms in contact, so all of them change.
            for i in range(model.ngeom):
                name = model.geom(i).name
                if int(model.geom_bodyid[i]) == rod or name.endswith("_pad") or name == "table_top":
                    model.geom_friction[i, 0] = self.friction
        joint = model.joint(JOINT_NAMES[index % DOF])
        joint.damping[0] *= self.joint_friction_factor
        joint.frictionloss[0] *= self.joint_friction_factor
        _derive(model)

    def disturbance(self, rng: np.random.Generator) -> Callable[[World], None] | None:
        """Return what acts on the world after every step of a trial, or None if nothing does."""
        return None if self.push is None else _Pusher(self.push, float(rng.uniform(*_DELAY_S)))


_CHANGED = ("body_mass", "body_inertia", "geom_friction", "dof_damping", "dof_frictionloss")


def _derive(model: mujoco.MjModel) -> None:
    """Recompute what MuJoCo derives from masses: subtree masses and the weights that soften its constraints."""
    mujoco.mj_setConst(model, mujoco.MjData(model))


class _Pusher:
    """Pushes once. It reads the truth, as the hand of somebody who stands beside the table would."""

    def __init__(self, push: Push, delay_s: float) -> None:
        self._push, self._delay_s = push, delay_s
        self._rest_m: float | None = None
        self._risen_s: float | None = None

    def __call__(self, world: World) -> None:
        body = world.model.body("rod").id
        height = float(world.data.xpos[body, 2])
        if self._rest_m is None:
            self._rest_m = height
        if self._risen_s is None:
            if height - self._rest_m > _RISEN_M:
                self._risen_s = world.time
            return
        since = world.time - self._risen_s - self._delay_s
        world.data.xfrc_applied[body, :3] = self._push.at(since)


_PUSH_N = 20.0
_AXES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}

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
        Condition("mass -50 %", "an object of half the mass that is expected", mass_factor=0.5),
        Condition(
            "mass +50 %", "an object of one and a half times the mass that is expected", mass_factor=1.5
        ),
        Condition("friction 0.3", "smoother pads, object and table than expected", friction=0.3),
        Condition("friction 0.7", "rougher pads, object and table than expected", friction=0.7),
        Condition(
            "pose noise x3",
            "the camera sees the object three times as badly",
            settings={"carry.sensing.pose_noise_m": 0.0015, "carry.sensing.pose_noise_rad": 0.0157},
        ),
        Condition(
            "delay 20 ms", "pose and forces arrive twice as late", settings={"carry.sensing.delay_s": 0.020}
        ),
        Condition(
            "joint friction x2",
            "one joint, another each trial, with doubled friction",
            joint_friction_factor=2.0,
        ),
    )
}


def condition(name: str) -> Condition:
    """Return a condition by name, or say which exist."""
    if name not in CONDITIONS:
        raise unknown_name("condition", name, CONDITIONS)
    return CONDITIONS[name]
