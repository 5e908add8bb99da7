"""Configuration of the plant that stages drive."""

from pydantic import Field

from minidual.config.base import StrictModel


class PlantConfig(StrictModel):
    """Which plant, and how it is driven."""

    address: str = Field(default="sim", min_length=1, max_length=300)
    """`sim`, `sim-position`, `franka://HOST,HOST` or `MODULE:FACTORY`."""
    rate_hz: float = Field(default=50.0, ge=50.0, le=100.0)
    """Rate of joint targets, of plants that take them."""
    velocity_share: float = Field(default=0.8, ge=0.01, le=1.0)
    """Share of the vendor's velocity limits that its interpolation may use."""
    acceleration_share: float = Field(default=0.4, ge=0.01, le=1.0)
    """The same of acceleration and jerk.

    A target that replaces another begins at a velocity measured over the last millisecond. Above
    one half the step to it may exceed the jerk limit.
    """
    collision_torque_nm: float = Field(default=25.0, ge=1.0, le=100.0)
    """External torque of a joint at which the vendor's controller stops."""
    collision_force_n: float = Field(default=40.0, ge=1.0, le=100.0)
    """External force of a hand at which the vendor's controller stops."""
    grip_n: float = Field(default=40.0, ge=1.0, le=70.0)
    """Force with which a hand closes."""
