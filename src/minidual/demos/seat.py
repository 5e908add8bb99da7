"""The leader's control of an episode: its start, its pauses and its end."""

import time
from collections.abc import Callable
from dataclasses import replace

from minidual.config.learning import TeleopConfig
from minidual.demos.mirror import Mirror, Mirrored
from minidual.demos.station import PAUSED, Button, Station, Status
from minidual.errors import UsageError
from minidual.tasks.task import Task

_POLL_S = 0.02
_ENDINGS = (Button.SUCCESS, Button.FAILURE, Button.DISCARD, Button.NEXT)
_SKIPS = (Button.NEXT,)
"""Buttons that count before an episode has begun."""


def for_a_person(task: Task, time_limit_s: float) -> Task:
    """Return a task whose time limit is that of a person."""
    config = task.config
    limits = config.scene.task.model_copy(update={"time_limit_s": time_limit_s})
    scene = config.scene.model_copy(update={"task": limits})
    return replace(task, config=config.model_copy(update={"scene": scene}))


class Seat:
    """Reads a leader and the buttons of its station.

    The time of the simulation stands still while a person has not started, while leader and arms are
    apart at the start, and in a pause. `freeze` is called then, so that pictures go on.

    Attributes:
        mirror: Reads the leader.
        ending: The button that ended the episode, or None.
        pressed: Buttons of the last tick.
        late_s: Wall time by which the last tick came late; 0 for a leader that is no person.
        last: What became of the episode before, shown until this one begins.
    """

    def __init__(
        self,
        mirror: Mirror,
        station: Station,
        config: TeleopConfig,
        freeze: Callable[[], None],
    ) -> None:
        self.mirror = mirror
        self.ending: Button | None = None
        self.pressed: tuple[Button, ...] = ()
        self.late_s = 0.0
        self.last = ""
        self._station = station
        self._config = config
        self._freeze = freeze
        self._is_person = mirror.leader.features.realtime
        self._period_s = 1.0 / config.rate_hz
        self._began_s = 0.0
        self._paused = False
        self._age_s: float | None = None

    def begin(self) -> Button | None:
        """Wait until the leader may lead; return the button that skips the trial, or None.

        Raises:
            UsageError: A leader that is no person stands elsewhere than the arms.
        """
        if not self._is_person:
            sample = self.mirror.leader.read(0.0)
            if sample is not None:
                self.mirror.check_start(sample)
            return None
        started = not self._config.person.wait_for_start
        give_up_s = time.monotonic() + self._config.person.wait_max_s
        while True:
            pressed = self._poll(0.0)
            skip = next((button for button in pressed if button in _SKIPS), None)
            if skip is not None:
                return skip
            started = started or Button.START in pressed
            if started and self.mirror.gate.is_open:
                return None
            self._show("move the leader to where the arms are" if started else "press start")
            if time.monotonic() > give_up_s:
                raise self._never_began(started)
            self._freeze()
            time.sleep(_POLL_S)

    def _never_began(self, started: bool) -> UsageError:
        waited = f"after {self._config.person.wait_max_s:g} s"
        if not started:
            return UsageError(f"nobody pressed start {waited}", remedy="start, or end with Ctrl-C")
        return UsageError(
            f"leader and arms are still apart {waited}: {self.mirror.gate.held}",
            remedy="bring the leader to the arms' posture, or use its clutch; "
            "check the joint order, the signs and the offsets",
        )

    def start_clock(self) -> None:
        """Let the time of the episode run."""
        self.last = ""
        self._began_s = time.monotonic()

    def wait_for_tick(self, k: int) -> Button | None:
        """Wait until tick k is due; return the button that ended a pause and the episode, or None."""
        if not self._is_person:
            return None
        if self._paused:
            button = self._wait_in_pause(k)
            if button is not None:
                return button
        early_s = self._began_s + k * self._period_s - time.monotonic()
        self.late_s = max(0.0, -early_s)
        time.sleep(max(0.0, early_s))
        return None

    def _wait_in_pause(self, k: int) -> Button | None:
        since_s = time.monotonic()
        while self._paused:
            pressed = self._poll(k * self._period_s)
            ending = next((button for button in pressed if button in _ENDINGS), None)
            if ending is not None:
                return ending
            if Button.PAUSE in pressed:
                self._paused = False
                # Handles and keys that were moved in the pause have led nothing.
                self.mirror.leader.resume(self.mirror.gate.target)
            self._show(PAUSED)
            self._freeze()
            time.sleep(_POLL_S)
        self._began_s += time.monotonic() - since_s
        return None

    def read(self, k: int, *, moves: bool = True) -> Mirrored | None:
        """Return the leader's reading at tick k; see `ending`. It moves the arms unless told not to."""
        now_s = k * self._period_s
        reading = self.mirror.read(now_s) if moves else self.mirror.poll(now_s)
        pressed = self._station.pressed()
        if reading is not None:
            pressed = (*pressed, *reading.pressed)
            self._age_s = reading.age_s
        self.pressed = pressed
        self.ending = next((button for button in pressed if button in _ENDINGS), None)
        self._paused = Button.PAUSE in pressed
        if self._is_person:
            self._show("leading", self._config.person.time_limit_s - now_s)
        return reading

    def _poll(self, now_s: float) -> tuple[Button, ...]:
        """Return the buttons pressed; targets are only compared with the arms."""
        reading = self.mirror.poll(now_s)
        pressed = self._station.pressed()
        if reading is not None:
            pressed = (*pressed, *reading.pressed)
            self._age_s = reading.age_s
        return pressed

    def _show(self, state: str, time_left_s: float | None = None) -> None:
        status = Status(
            state=state,
            time_left_s=time_left_s,
            hint=self.mirror.hint,
            held=self.mirror.gate.held,
            latency_s=self._age_s,
            last=self.last,
        )
        self._station.show(status)
