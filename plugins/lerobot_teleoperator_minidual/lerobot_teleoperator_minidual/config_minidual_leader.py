"""Options of `--teleop.type=minidual_leader`."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.teleoperators import TeleoperatorConfig


@TeleoperatorConfig.register_subclass("minidual_leader")
@dataclass(kw_only=True)
class MinidualLeaderConfig(TeleoperatorConfig):
    """A leader of minidual.

    Attributes:
        leader: scripted, replay, keyboard, gamepad, gello, network or your own.
        task: Of arms that are not simulated in this process; `bi_minidual` brings its own.
        settings: Settings of minidual by dotted path, such as
            {"teleop.replay.path": "runs/standard/teleop-record/episodes"}.
    """

    leader: str = "scripted"
    task: str = "rod_carry"
    settings: dict[str, Any] = field(default_factory=dict)
