"""Read the angles of a chain of Dynamixel servos, protocol 2.0."""

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from minidual.errors import EnvironmentMissingError
from minidual.robot.pair import Array

_POSITION_ADDRESS = 132
_POSITION_BYTES = 4
_TICKS_PER_TURN = 4096
_MIDDLE_TICKS = 2048
_TRIES_N = 5
_ROUNDS_N = 4
"""Rounds of so many tries each; a machine that is busy for a moment may miss one round."""
_IDLE_S = 2e-4
_JOIN_S = 2.0


class DynamixelBus:
    """A serial port with servos.

    Args:
        port: Path of the device.
        baud_rate: Of the servos.
        ids: Of the servos that are read.

    Attributes:
        lost_n: Readings in which a servo's answer was lost or damaged.

    Raises:
        EnvironmentMissingError: No library, no port, or a servo that does not answer.
    """

    def __init__(self, port: str, baud_rate: int, ids: Sequence[int]) -> None:
        sdk = _sdk()
        self._port_name = port
        self._sdk = sdk
        self._ids = tuple(ids)
        self._port = _open(sdk, port, baud_rate)
        self._packets = sdk.PacketHandler(2.0)
        self._reader = sdk.GroupSyncRead(
            self._port,
            self._packets,
            _POSITION_ADDRESS,
            _POSITION_BYTES,
        )
        for servo in self._ids:
            self._reader.addParam(servo)
        self.lost_n = 0
        self._check_answers()

    def _check_answers(self) -> None:
        for _ in range(_ROUNDS_N):
            if any(self.read() is not None for _ in range(_TRIES_N)):
                self.lost_n = 0
                return
            answers, _ = self._packets.broadcastPing(self._port)
            missing = [str(servo) for servo in self._ids if servo not in answers]
            if missing:
                self.close()
                present = ", ".join(str(servo) for servo in sorted(answers)) or "none"
                raise EnvironmentMissingError(
                    f"no answer from servo {', '.join(missing)} at {self._port_name}; "
                    f"the ids that answer: {present}",
                    remedy="check the power, the cables, baud_rate and ids of the file",
                )
        self.close()
        raise EnvironmentMissingError(
            f"the servos at {self._port_name} answer one by one, but never all at once",
            remedy="check the cables, and whether another program reads the port",
        )

    def read(self) -> Array | None:
        """Return the angles (k,) [rad]; None if an answer was lost.

        Raises:
            OSError: The port is gone.
        """
        if self._reader.txRxPacket() != self._sdk.COMM_SUCCESS:
            self.lost_n += 1
            return None
        ticks = [
            self._reader.getData(servo, _POSITION_ADDRESS, _POSITION_BYTES) for servo in self._ids
        ]
        signed = np.array(ticks, dtype=np.uint32).view(np.int32).astype(np.float64)
        return (signed - _MIDDLE_TICKS) * (2.0 * np.pi / _TICKS_PER_TURN)

    def close(self) -> None:
        """Free the port."""
        self._port.closePort()


class BusReader:
    """Reads a bus all the time in a thread of its own, so that callers do not wait for it."""

    def __init__(self, bus: DynamixelBus) -> None:
        self._bus = bus
        self._lock = threading.Lock()
        self._angles: Array | None = None
        self._read_at_s = float("-inf")
        self._ends = threading.Event()
        self.failure = ""
        self._thread = threading.Thread(target=self._run, daemon=True, name="dynamixel")
        self._thread.start()

    def newest(self) -> tuple[Array | None, float]:
        """Return the newest angles (k,) [rad] and their age [s]."""
        with self._lock:
            return self._angles, time.monotonic() - self._read_at_s

    @property
    def lost_n(self) -> int:
        """Readings that were lost."""
        return self._bus.lost_n

    def _run(self) -> None:
        while not self._ends.is_set():
            try:
                angles = self._bus.read()
            except (OSError, TypeError) as error:  # pyserial raises TypeError on a closed port
                self.failure = str(error)
                return
            if angles is not None:
                with self._lock:
                    self._angles = angles
                    self._read_at_s = time.monotonic()

    def close(self) -> None:
        """End the thread and free the port."""
        self._ends.set()
        self._thread.join(_JOIN_S)
        self._bus.close()


def _sdk() -> Any:
    try:
        import dynamixel_sdk
    except ImportError as error:
        raise EnvironmentMissingError(
            "the gello leader needs the library dynamixel-sdk",
            remedy="pip install 'minidual[gello]'",
        ) from error
    return dynamixel_sdk


def _open(sdk: Any, name: str, baud_rate: int) -> Any:
    class Port(sdk.PortHandler):
        """Does not spin while nothing comes."""

        def readPort(self, length: int) -> bytes:
            data = self.ser.read(length)
            if not data:
                time.sleep(_IDLE_S)
            return data

    port = Port(name)
    try:
        opened = port.setBaudRate(baud_rate)
    except OSError as error:  # also what pyserial raises
        raise EnvironmentMissingError(
            f"the serial port {name} cannot be opened: {error}",
            remedy="ls -l /dev/serial/by-id; a user of the group 'dialout' may open the ports",
        ) from error
    if not opened:
        raise EnvironmentMissingError(
            f"the baud rate {baud_rate} is none of dynamixel-sdk",
            remedy="set baud_rate to 57600, 1000000 or another one of the servos",
        )
    return port
