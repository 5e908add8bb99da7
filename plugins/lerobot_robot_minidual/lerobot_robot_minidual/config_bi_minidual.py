"""Options of `--robot.type=bi_minidual`."""

from dataclasses import dataclass, field

from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("bi_minidual")
@dataclass(kw_only=True)
class BiMinidualConfig(RobotConfig):
    """Two simulated arms.

    Attributes:
        task: rod_carry, pot_lift, handover, insertion, sort or your own.
        views: Cameras: high, left, right.
        fps: Rate of actions; each lets 1 / fps of simulated time pass. Give --dataset.fps the same.
        start: Number of the first start.
        seed: Of the starts; by default that of minidual's profiles.
        episode_time_s: Wall time of an episode, as --dataset.episode_time_s: the next start begins
            then. By default it begins when the leader ends the episode by a button.
    """

    task: str = "rod_carry"
    views: list[str] = field(default_factory=lambda: ["high"])
    fps: float = 50.0
    start: int = 0
    seed: int | None = None
    episode_time_s: float | None = None
