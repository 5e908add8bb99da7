"""A gamepad of the Linux input system."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

from minidual.errors import EnvironmentMissingError

_STICKS = {"ABS_X", "ABS_Y", "ABS_RX", "ABS_RY"}


class Event(NamedTuple):
    """A change of an axis or button: its name in evdev, and its value."""

    code: str
    value: float


class Range(NamedTuple):
    """Ends of an axis."""

    lower: float
    upper: float


class GamepadDevice(ABC):
    """Gives events.

    Attributes:
        ranges: Of the axes, by name.
    """

    ranges: dict[str, Range]

    @abstractmethod
    def read(self) -> Sequence[Event] | None:
        """Return the events since the last call; None once the device is gone."""

    def close(self) -> None:  # noqa: B027 (recorded events hold nothing)
        """Release the device."""


class EvdevGamepad(GamepadDevice):
    """A device under /dev/input.

    Args:
        path: Of the device; empty for the first with two sticks.

    Raises:
        EnvironmentMissingError: No library, no such device, or it may not be opened.
    """

    def __init__(self, path: str) -> None:
        evdev = _evdev()
        self._device = _named(evdev, path) if path else _first_with_sticks(evdev)
        self._names: dict[tuple[int, int], str] = {}
        self.ranges = {}
        axes: Any = evdev.ecodes.EV_ABS
        for code, info in self._device.capabilities().get(axes, []):
            name = _code_name(evdev, evdev.ecodes.ABS, code)
            self._names[axes, code] = name
            self.ranges[name] = Range(info.min, info.max)
        for code in self._device.capabilities().get(evdev.ecodes.EV_KEY, []):
            name = _code_name(evdev, evdev.ecodes.BTN | evdev.ecodes.KEY, code)
            self._names[evdev.ecodes.EV_KEY, code] = name

    def read(self) -> Sequence[Event] | None:
        """Return the events since the last call; None once it is unplugged."""
        events: list[Event] = []
        try:
            while True:
                event = self._device.read_one()
                if event is None:
                    return events
                name = self._names.get((event.type, event.code))
                if name is not None:
                    events.append(Event(name, event.value))
        except OSError:
            return None

    def close(self) -> None:
        """Release the device."""
        self._device.close()


def _evdev() -> Any:
    """Return the library, by name: an extra that the type checker need not find."""
    try:
        return importlib.import_module("evdev")
    except ImportError as error:
        raise EnvironmentMissingError(
            "the gamepad leader needs the library evdev",
            remedy="pip install 'minidual[gamepad]'",
        ) from error


def _code_name(evdev: Any, table: dict[int, Any], code: int) -> str:
    """Return the name of a code; of several, that by its position, such as BTN_SOUTH."""
    names = table.get(code, str(code))
    if isinstance(names, str):
        return names
    by_position = ("BTN_SOUTH", "BTN_EAST", "BTN_NORTH", "BTN_WEST")
    return next((name for name in names if name in by_position), names[0])


def _named(evdev: Any, path: str) -> Any:
    try:
        return evdev.InputDevice(path)
    except OSError as error:
        raise EnvironmentMissingError(
            f"the gamepad {path} cannot be opened: {error.strerror or error}",
            remedy="ls -l /dev/input; a user of the group 'input' may open the devices",
        ) from error


def _first_with_sticks(evdev: Any) -> Any:
    for path in evdev.list_devices():
        device = evdev.InputDevice(path)
        axes = device.capabilities().get(evdev.ecodes.EV_ABS, [])
        names = {_code_name(evdev, evdev.ecodes.ABS, code) for code, _ in axes}
        if names >= _STICKS:
            return device
        device.close()
    raise EnvironmentMissingError(
        "there is no gamepad with two sticks under /dev/input that this user may open",
        remedy="plug it in; join the group 'input'; or --set teleop.gamepad.device=PATH",
    )
