"""Write: torques or joint targets, and finger targets, to the plant; then the plant goes on."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from minidual.control.gripper import Grippers
from minidual.control.measurement import Measurement
from minidual.plant.lifecycle import CommandKind, kind_of
from minidual.plant.protocol import Plant, PlantEndedError
from minidual.robot.pair import Array


class Reference(NamedTuple):
    """Where the arms are led.

    Attributes:
        q: Joint targets (n,) [rad].
        leads: Names of the controllers that lead them, or `("reflex",)`.
    """

    q: Array
    leads: tuple[str, ...]


class PlantWriter:
    """The only writer to a plant. What fails is reported, and the plant goes on.

    Args:
        v_max: Largest joint velocities (n,) [rad/s].
        reference: Returns where the arms are led in this tick; asked where the plant takes joint targets.
        report: Called with what failed.

    Attributes:
        applied: Last torques (n,) [Nm] that the plant has taken, or has measured.
        by_position: Whether the plant takes joint targets.
    """

    applied: Array

    def __init__(
        self,
        plant: Plant,
        grippers: Grippers,
        v_max: Array,
        reference: Callable[[], Reference],
        report: Callable[[Exception], None],
    ) -> None:
        self._plant = plant
        self._grippers = grippers
        self._v_max = v_max
        self._reference = reference
        self._report = report
        self.by_position = kind_of(plant) is CommandKind.POSITION

    def begin(self, q: Array) -> None:
        """Start at the measured posture (n,) [rad]; nobody has led the arms yet."""
        self._sent = Reference(q, ())

    def resume(self, q: Array) -> None:
        """Go on from the measured posture (n,) [rad] with the same leads."""
        self._sent = Reference(q, self._sent.leads)

    def write(
        self,
        measurement: Measurement,
        tau: Array,
        openings: Array,
        *,
        braking: bool,
    ) -> None:
        """Send torques (n,) [Nm] and hand openings (2,), and let the plant go on.

        Args:
            braking: Whether the arms that are not measured get the plant's brakes.

        Raises:
            PlantEndedError: There is nothing left to drive.
        """
        try:
            fingers_m = self._grippers.step(openings, measurement.fingers_m, measurement.grip_n)
        except Exception as error:
            self._report(error)
            fingers_m = self._grippers.targets_m
        try:
            if self.by_position:
                self._send_targets(self._plant, openings)
            else:
                self._plant.command(tau, fingers_m)
            self.applied = tau
            if braking:
                self._plant.brake(measurement.blind_arms)
        except PlantEndedError:
            raise
        except Exception as error:
            self._report(error)
        try:
            self._plant.step()  # the arms go on moving, told or not
        except PlantEndedError:
            raise
        except Exception as error:
            self._report(error)

    def _send_targets(self, plant: Any, openings: Array) -> None:
        """Send joint targets with their velocities, which are those of the step from the last ones."""
        reference = self._reference()
        v = (reference.q - self._sent.q) / plant.dt
        if reference.leads != self._sent.leads:  # a new reference begins where the arms are
            v = np.zeros(len(v))
        plant.follow(reference.q, np.clip(v, -self._v_max, self._v_max), openings)
        self._sent = reference
