"""Configuration of what leads the arms while demonstrations are recorded."""

from typing import Literal

from pydantic import Field, field_validator

from minidual.config.base import StrictModel
from minidual.config.link import SimulatedNetwork


class MirrorConfig(StrictModel):
    """When a leader may drive the follower."""

    start_error_max_rad: float = Field(default=0.1, ge=0.001, le=0.6)
    """Most difference of a joint between leader and follower at which the follower begins."""
    jump_max_rad: float = Field(default=0.5, ge=0.05, le=3.0)
    """Most change of a joint between two readings; after a larger one the follower holds."""
    hand_speed_max_m_s: float = Field(default=0.4, ge=0.01, le=1.0)
    """Of leaders that send hand poses, as the next ones."""
    hand_turn_max_rad_s: float = Field(default=1.5, ge=0.05, le=4.0)
    hand_lag_s: float = Field(default=0.1, ge=0.0, le=1.0)
    """Time constant of the filter of hand poses."""
    hand_ramp_s: float = Field(default=0.25, ge=0.0, le=2.0)
    """Time in which a hand reaches its largest speed at the soonest; a jerk lets an object slip."""
    hand_height_min_m: float = Field(default=0.01, ge=-1.0, le=1.0)
    """Least height of a finger tip above the table; goals below it are raised to it."""


class PersonConfig(StrictModel):
    """Limits of a session that a person leads."""

    time_limit_s: float = Field(default=120.0, ge=5.0, le=3600.0)
    """Of an episode, in place of the task's."""
    wait_for_start: bool = True
    """Whether an episode waits for the start button; false for runs without anybody there."""
    wait_max_s: float = Field(default=3600.0, gt=0.0, le=86_400.0)
    """Longest wait for the start button, or for the leader to stand where the arms stand."""
    attempts_max: int | None = Field(default=None, ge=1, le=100_000)
    """Most attempts of a session; None: as many as the person makes."""
    rest_after_episodes: int = Field(default=20, ge=0, le=1000)
    """Episodes after which a rest is proposed; 0: never."""


class LinkConfig(StrictModel):
    """A simulated network between leader and arms, and the link over it."""

    network: str = ""
    """Such as delay=100ms,jitter=20ms,loss=5%,reorder=1%; empty: the leader stands beside the arms."""
    passive: bool = True
    """Whether the link's controllers keep both ports passive; its energies are observed anyway."""
    takes_back_drift: bool = True
    energy_min_j: float = Field(default=-0.5, ge=-1e3, le=0.0)
    """Observed energy below which a port makes energy."""
    short_max_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Time under that bound after which the supervisor stops the arms."""

    @field_validator("network")
    @classmethod
    def _is_a_network(cls, text: str) -> str:
        if text:
            SimulatedNetwork.parse(text)
        return text


class NetworkConfig(StrictModel):
    """A program that leads over UDP or a WebSocket."""

    transport: Literal["udp", "websocket"] = "udp"
    host: str = Field(default="127.0.0.1", min_length=1)
    """Interface; the default serves programs on this machine only. Messages are not encrypted."""
    port: int = Field(default=8765, ge=0, le=65535)
    """0 takes a free one."""
    silence_max_s: float = Field(default=0.25, gt=0.0, le=10.0)
    """Age after which the last target counts as no reading, and another sender may lead."""
    origins: tuple[str, ...] = ()
    """Of pages, such as http://localhost:3000, that may lead over a WebSocket; programs always may."""


class GamepadConfig(StrictModel):
    """A gamepad."""

    device: str = ""
    """Path such as /dev/input/event5; empty: the first with two sticks."""
    mapping: str = ""
    """YAML file of the mapping; empty: demos/leaders/gamepad.yaml of the package."""
    speed_m_s: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of a hand at a stick that is pushed to its end."""
    turn_rad_s: float = Field(default=0.8, gt=0.0, le=4.0)
    dead_zone: float = Field(default=0.12, ge=0.0, le=0.9)
    """Share of a stick's travel that moves nothing."""


class GelloConfig(StrictModel):
    """Two chains of Dynamixel servos with the joints of the arms."""

    file: str = "gello.yaml"
    """Ports, ids, signs, offsets and grippers; `minidual leader calibrate` writes the offsets."""
    silence_max_s: float = Field(default=0.25, gt=0.0, le=10.0)
    """Age after which the last reading counts as none."""


class MultiplyConfig(StrictModel):
    """Recorded demonstrations that lead at other starts and goals (`minidual data augment`)."""

    path: str = ""
    """A run, a recording, or a folder of HDF5 episodes."""
    demonstrations_n: int = Field(default=0, ge=0, le=1_000_000)
    """At most so many of them, the first; 0: all."""
    nearest_n: int = Field(default=3, ge=1, le=1000)
    """A trial draws one of so many whose start and goal are nearest to its own."""
    near_m: float = Field(default=0.12, gt=0.0, le=0.5)
    """Distance from its grasp at which a hand's motion begins to belong to the object."""


class ReplayConfig(StrictModel):
    """A recorded episode that leads."""

    path: str = ""
    """An episode's HDF5 file, a folder of them, or a LeRobot dataset."""
    episode: int = Field(default=-1, ge=-1, le=1_000_000)
    """Number in the folder or dataset; -1: the number of the trial."""
