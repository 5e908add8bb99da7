"""Description of one trouble: its level, symptom, cause, and minidual's answer."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

type Kind = Literal[
    "check", "reflex", "refusal", "fault", "episode fault", "message", "command", "setting"
]


class Level(IntEnum):
    """Where a trouble lies, from below; look for it in this order."""

    INSTALLATION = 0
    SIMULATION = 1
    ONE_ARM = 2
    BOTH_ARMS = 3
    TELEOPERATION = 4
    DATA = 5
    POLICY = 6

    @property
    def text(self) -> str:
        """Name for people."""
        return LEVELS[self].name


@dataclass(frozen=True)
class LevelText:
    """A level in words.

    Attributes:
        question: What must be answered with yes before the next level is worth a look.
        command: What answers it.
    """

    name: str
    question: str
    command: str


LEVELS: dict[Level, LevelText] = {
    Level.INSTALLATION: LevelText(
        "installation",
        "Do the libraries fit, and can pictures be drawn?",
        "minidual env-check --markdown",
    ),
    Level.SIMULATION: LevelText(
        "simulation and joints",
        "Is each joint read, and does each command move its own joint?",
        "minidual env-check",
    ),
    Level.ONE_ARM: LevelText(
        "one arm",
        "Does each joint follow its reference, gravity compensated?",
        "minidual env-check",
    ),
    Level.BOTH_ARMS: LevelText(
        "both arms",
        "Do both arms plan, and carry an object, without contact and in step?",
        "minidual run --until carry",
    ),
    Level.TELEOPERATION: LevelText(
        "teleoperation",
        "Do the arms follow the leader in time?",
        "minidual teleop-record",
    ),
    Level.DATA: LevelText(
        "data",
        "Are the episodes complete, in step, and commands rather than readings?",
        "minidual doctor",
    ),
    Level.POLICY: LevelText(
        "policy",
        "Does the loss fall, and does the policy act inside the limits?",
        "minidual run --until deploy",
    ),
}


@dataclass(frozen=True)
class Reference:
    """Something of minidual that detects a trouble or mends it.

    Attributes:
        name: A stage and its check for "check", else a name of that kind.
    """

    kind: Kind
    name: str

    @property
    def is_live(self) -> bool:
        """Whether `doctor` measures it on this machine: the stages up to `carry` run again."""
        stage = self.name.split()[0]
        return self.kind == "check" and stage in ("env-check", "plan", "carry")

    @property
    def is_read_back(self) -> bool:
        """Whether `doctor` finds it in what a run holds: verdicts, recordings, policy."""
        return self.kind in ("check", "episode fault") and not self.is_live

    def __str__(self) -> str:
        return f"{self.kind} `{self.name}`"


def check(stage: str, name: str) -> Reference:
    """Return a check of a stage."""
    return Reference("check", f"{stage} {name}")


def reflex(label: str) -> Reference:
    """Return a reflex of the supervisor."""
    return Reference("reflex", label)


def refusal(name: str) -> Reference:
    """Return a refusal of the arbiter."""
    return Reference("refusal", name)


def fault(name: str) -> Reference:
    """Return a fault of a carry."""
    return Reference("fault", name)


def episode_fault(name: str) -> Reference:
    """Return a fault of a recorded file."""
    return Reference("episode fault", name)


def message(text: str) -> Reference:
    """Return a part of an error message."""
    return Reference("message", text)


def command(words: str) -> Reference:
    """Return a command; `words` begin with minidual or make."""
    return Reference("command", words)


def setting(path: str) -> Reference:
    """Return a field of the configuration, as for `--set`."""
    return Reference("setting", path)


@dataclass(frozen=True)
class Trouble:
    """A row of the catalogue.

    Attributes:
        number: Row of the tutorial's table, 1 to 52.
        name: For `minidual doctor --explain`.
        answer: What minidual does about it.
        references: What detects or mends it, the surest sign first.
    """

    number: int
    name: str
    level: Level
    symptom: str
    cause: str
    answer: str
    references: tuple[Reference, ...]

    def is_shown_by(self, reference: Reference) -> bool:
        """Return whether a failed check or a fault of an episode means this trouble."""
        is_fault = reference.kind == "episode fault" and reference in self.references
        return is_fault or reference == self.references[0]

    @property
    def probed(self) -> Literal["here", "in a run", ""]:
        """Where `doctor` probes it: on this machine, in what a run holds, or "" for nowhere."""
        if any(reference.is_live for reference in self.references):
            return "here"
        if any(reference.is_read_back for reference in self.references):
            return "in a run"
        return ""


@dataclass(frozen=True)
class Mistake:
    """A trouble that is often looked for in the wrong place.

    Attributes:
        blamed: Where people look first.
        place: Where the cause often lies.
        reference: What tells.
    """

    symptom: str
    blamed: str
    place: str
    reference: Reference
