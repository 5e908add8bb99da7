"""Lead along joints that are known beforehand."""

from minidual.demos.leader import Leader, LeaderSample
from minidual.demos.station import Button
from minidual.skills.operator import Demonstration


class PlayingLeader(Leader):
    """Plays joint targets at their rate, then reports success.

    Attributes:
        demonstration: What is played.
    """

    demonstration: Demonstration

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the targets of a time."""
        q, openings = self.demonstration.at(now_s)
        half_tick_s = 0.5 / self.demonstration.rate_hz
        has_ended = now_s >= self.demonstration.duration_s - half_tick_s
        return LeaderSample(openings, q=q, pressed=(Button.SUCCESS,) if has_ended else ())
