"""A person leads with the mouse, in the live view."""

from typing import ClassVar, Self

import numpy as np

from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.station import Button, HandHandles
from minidual.errors import EnvironmentMissingError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Trial


class BrowserLeader(Leader):
    """Gives the poses of handles that a person drags in a picture of the scene."""

    features: ClassVar[Features] = Features(
        targets="poses",
        buttons=tuple(Button),
        clutch=True,
        realtime=True,
        picture=True,
    )
    usage: ClassVar[str] = (
        "browser: open the address of the view; press Start; drag the arrows and rings at a hand "
        "to move and turn it, those between the hands to move both; close a hand with its slider; "
        "end with Success"
    )

    def __init__(self, robot: Robot, handles: HandHandles) -> None:
        self._kinematics = Kinematics(robot)
        self._handles = handles
        self._q = robot.home
        self._was_clutched = False

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Take the handles of the station.

        Raises:
            EnvironmentMissingError: There is no live view.
        """
        handles = setup.station.handles()
        if handles is None:
            raise EnvironmentMissingError(
                "the browser leader needs the live view, and there is none",
                remedy="add --view web",
            )
        return cls(setup.robot, handles)

    @property
    def hint(self) -> str:
        """How high the finger tips are: a picture hardly shows it."""
        left, right = (1e3 * float(T[2, 3]) for T in self._kinematics.tcp_poses(self._q))
        return f"finger tips above the table: left {left:.0f} mm, right {right:.0f} mm"

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Put the handles at the hands, which are open."""
        self._q = q_follower
        self._was_clutched = False
        self._handles.open()
        self._place()

    def resume(self, q_follower: Array) -> None:
        """Put the handles at the hands, which stay as they are."""
        self._q = q_follower
        self._was_clutched = False
        self._place()

    def _place(self) -> None:
        self._handles.place([T.copy() for T in self._kinematics.tcp_poses(self._q)])

    def read(self, now_s: float) -> LeaderSample | None:
        """Return where the handles are. Released from the clutch, they return to the hands."""
        reading = self._handles.read()
        if self._was_clutched and not reading.clutch:
            self._place()
            reading = self._handles.read()
        self._was_clutched = reading.clutch
        return LeaderSample(
            np.array(reading.openings),
            Ts_world_tcp=reading.Ts_world_tcp,
            clutch=reading.clutch,
            age_s=reading.latency_s,
        )

    def feedback(self, feedback: Feedback) -> None:
        """Remember where the arms are."""
        self._q = feedback.q
