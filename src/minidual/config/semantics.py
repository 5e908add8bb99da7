"""What the robot's geometry does not say: groups, named states and end effectors, as an SRDF says them.

The robot itself holds these to account: `minidual.motion.semantics` refuses a chain that the model does not have,
a state outside the limits or of the wrong length, and a group of other joints than the planner's.
"""

from __future__ import annotations

from pydantic import Field, field_validator

from minidual.config.base import StrictModel

_HOME = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)


class ChainConfig(StrictModel):
    """The joints between two links: an SRDF `chain`."""

    base_link: str = Field(min_length=1)
    tip_link: str = Field(min_length=1)


class GroupConfig(StrictModel):
    """A planning group: one chain an arm, left first."""

    chains: tuple[ChainConfig, ...] = Field(min_length=1)


class EndEffectorConfig(StrictModel):
    """A hand: the group that moves it and the frame that pose goals are given for."""

    group: str
    parent_link: str
    tcp_link: str


class NamedStateConfig(StrictModel):
    """A posture with a name. One arm may be left out; the state then says nothing about it."""

    left_rad: tuple[float, ...] | None = None
    """Joints 1 to 7 of the left arm."""
    right_rad: tuple[float, ...] | None = None
    """Joints 1 to 7 of the right arm."""
    description: str = ""


def _chain(arm: str) -> ChainConfig:
    return ChainConfig(base_link=f"{arm}_panda_link0", tip_link=f"{arm}_panda_hand_tcp")


def _hand(arm: str) -> EndEffectorConfig:
    return EndEffectorConfig(group=f"{arm}_arm", parent_link=f"{arm}_panda_hand", tcp_link=f"{arm}_panda_hand_tcp")


def _same(joints: tuple[float, ...], description: str) -> NamedStateConfig:
    return NamedStateConfig(left_rad=joints, right_rad=joints, description=description)


_STATES: dict[str, NamedStateConfig] = {
    "home": _same(_HOME, "where every run begins"),
    "ready": _same(
        (0.0, -0.1848, 0.0, -2.4967, 0.0, 2.3119, 0.7854), "hands down, 25 cm over the table, fingers along x"
    ),
    "carry": NamedStateConfig(
        left_rad=(-0.216, 0.0891, -0.0384, -2.3191, 0.0051, 2.4081, -1.0434),
        right_rad=(0.0716, 0.0905, 0.1829, -2.319, -0.0246, 2.4079, -0.5134),
        description="hands 24 cm apart at the middle, 20 cm over the table, as they hold the rod",
    ),
    "raised": NamedStateConfig(
        left_rad=(0.0242, -0.3986, 0.0716, -1.7764, 0.0283, 1.3788, 0.8811),
        right_rad=(-0.0244, -0.3986, -0.0715, -1.7764, -0.0283, 1.3788, 0.6897),
        description="hands 60 cm over the table, out of the way of what stands on it",
    ),
    "folded": _same((0.0, -1.4, 0.0, -2.9, 0.0, 1.6, 0.785), "arms drawn back over their bases, the table free"),
}


class SemanticsConfig(StrictModel):
    """Groups, end effectors and named states."""

    groups: dict[str, GroupConfig] = Field(
        default={
            "left_arm": GroupConfig(chains=(_chain("left"),)),
            "right_arm": GroupConfig(chains=(_chain("right"),)),
            "both_arms": GroupConfig(chains=(_chain("left"), _chain("right"))),
        }
    )
    end_effectors: dict[str, EndEffectorConfig] = Field(
        default={"left_hand": _hand("left"), "right_hand": _hand("right")}
    )
    states: dict[str, NamedStateConfig] = Field(default=_STATES)
    """Named states; a profile or --set adds to the built-in ones, or replaces one under its name."""

    @field_validator("states")
    @classmethod
    def _with_built_in(cls, states: dict[str, NamedStateConfig]) -> dict[str, NamedStateConfig]:
        return {**_STATES, **states}
