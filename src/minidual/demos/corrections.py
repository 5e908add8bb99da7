"""A policy drives, and the leader takes over where it strays.

The button CORRECT, or the clutch, takes the arms over; CORRECT hands them back. Each tick says who
drove, so that training can weight what the policy did not know.
"""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from minidual.demos.mirror import Mirror, Mirrored
from minidual.demos.signals import Driver
from minidual.demos.station import Button
from minidual.errors import DataError
from minidual.plant.render import Image
from minidual.robot.pair import Array

OPENING_MET = 0.2
"""A hand's opening is taken from the leader once it is as near as this to the commanded one."""


class DrivingPolicy(Protocol):
    """Drives until the leader takes over.

    Attributes:
        cameras: Size of the pictures (H, W) by camera.
        inputs: Entries of what it reads beside joints and openings, by signal (`sensed.SENSED`).
    """

    @property
    def inputs(self) -> Mapping[str, int]:
        """See above."""
        ...

    @property
    def cameras(self) -> Mapping[str, tuple[int, int]]:
        """See above."""
        ...

    def reset(self) -> None:
        """Forget the episode so far."""
        ...

    def act(self, images: Mapping[str, Image], state: Array) -> Array:
        """Return joint targets (n,) [rad], then openings (2,).

        Raises:
            DataError: The policy cannot drive.
        """
        ...


class Wanted(NamedTuple):
    """A command of the arms.

    Attributes:
        target: Joints (n,) [rad].
        openings: Of the hands (2,).
    """

    target: Array
    openings: Array


class Corrections:
    """Who drives in an episode.

    Attributes:
        driver: Of this tick.
        refusal: Why the policy cannot drive, or "".
    """

    def __init__(self, policy: DrivingPolicy, mirror: Mirror) -> None:
        self._policy = policy
        self._mirror = mirror
        self.driver = Driver.POLICY
        self.refusal = ""

    def begin(self, q: Array, openings: Array) -> None:
        """Begin an episode with arms that stand at (n,) [rad], hands (2,); the policy drives."""
        self.driver = Driver.POLICY
        self.refusal = ""
        self._last = Wanted(np.array(q, dtype=float), np.array(openings, dtype=float))
        self._was_clutched = False
        self._follows: npt.NDArray[np.bool_] = np.zeros(2, dtype=bool)
        self._policy.reset()

    @property
    def drives(self) -> bool:
        """Whether the leader drives: it moves the arms only then."""
        return self.driver is Driver.CORRECTION

    def command(
        self,
        reading: Mirrored | None,
        pressed: tuple[Button, ...],
        images: Mapping[str, Image],
        state: Array,
    ) -> Wanted | None:
        """Return the next command of the arms; None: they keep their target.

        Args:
            reading: Of the leader; its target counts while it drives.
            pressed: All buttons of this tick.
            images: Pictures by camera.
            state: Joints (n,) [rad], openings (2,) and inputs of the policy, as measured.
        """
        clutched = reading is not None and reading.clutch
        if self.driver is Driver.POLICY:
            if Button.CORRECT in pressed or (clutched and not self._was_clutched):
                self._take_over()
        elif Button.CORRECT in pressed and not self.refusal:
            self._hand_back()
        self._was_clutched = clutched
        wanted = self._by_policy(images, state) if self.driver is Driver.POLICY else None
        if self.driver is Driver.CORRECTION and reading is not None:
            wanted = self._by_leader(reading)
        if wanted is not None:
            self._last = wanted
        return wanted

    def _take_over(self) -> None:
        self.driver = Driver.CORRECTION
        self._follows[:] = False
        self._mirror.begin(self._last.target)
        self._mirror.leader.resume(self._last.target)

    def _hand_back(self) -> None:
        self.driver = Driver.POLICY
        self._policy.reset()

    def _by_policy(self, images: Mapping[str, Image], state: Array) -> Wanted | None:
        """Return the policy's command; if it cannot drive, the leader takes over."""
        try:
            action = self._policy.act(images, state)
        except DataError as error:
            self.refusal = error.message
            self._take_over()
            return None
        joints_n = len(self._last.target)
        return Wanted(action[:joints_n], action[joints_n:])

    def _by_leader(self, reading: Mirrored) -> Wanted:
        """Return the leader's command; a hand keeps its opening until the leader's comes near it."""
        near = np.abs(reading.openings - self._last.openings) <= OPENING_MET
        self._follows |= near
        openings = np.where(self._follows, reading.openings, self._last.openings)
        if reading.clutch or not self._mirror.gate.is_open:
            return Wanted(self._last.target, openings)
        return Wanted(reading.target, openings)
