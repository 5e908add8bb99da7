"""Order faults from below, and separate causes from their consequences."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from minidual.errors import shortened
from minidual.stages.troubles.catalogue import TROUBLES
from minidual.stages.troubles.trouble import LEVELS, Level, check, episode_fault

_MOTIONS = (
    "env-check joints.*",
    "env-check tracking.*",
    "env-check control.stopped",
    "env-check contacts.sine",
    "env-check latency.*",
    "env-check stop.*",
    "env-check video.frames",
    "plan closed_chain.driven_n",
    "plan closed_chain.executed_*",
    "carry *",
)
"""Faults that follow if the arms do not move as they should."""

_EFFECTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("env-check libraries.unfit", ("env-check *", "plan *", "carry *", "policy *")),
    ("env-check joints.count", ("env-check *", "plan *", "carry *")),
    ("env-check model.agreement_max", _MOTIONS),
    ("env-check contacts.home", (*_MOTIONS, "plan *")),
    ("env-check joints.mapped", _MOTIONS),
    ("env-check joints.reached", _MOTIONS),
    ("env-check control.stopped", _MOTIONS),
    ("env-check tracking.*", _MOTIONS),
    ("env-check joints.*", _MOTIONS),
    (
        "env-check control.step_median_us",
        (
            "plan *replan*",
            "plan *time_median_s",
            "recordings rate_wrong",
            "recordings timestamps_jitter",
        ),
    ),
    (
        "env-check cameras.contrast_min",
        ("env-check cameras.*", "env-check video.frames", "recordings images_*", "policy *"),
    ),
    ("env-check cameras.*", ("env-check cameras.*", "recordings cameras_*", "policy *")),
    ("plan engines.agreement", ("plan proof.*", "plan *success_rate", "plan closed_chain.*")),
    ("plan left_arm.*", ("plan right_arm.*", "plan both_arms.*", "plan closed_chain.*")),
    ("plan right_arm.*", ("plan both_arms.*", "plan closed_chain.*")),
    ("plan both_arms.*", ("plan closed_chain.*",)),
    ("plan closed_chain.*", ("plan closed_chain.*",)),
    ("plan proof.*", ("plan proof.*",)),
    ("carry success_rate", ("carry *",)),
    ("recordings *", ("policy *",)),
)
"""(fault, consequences): patterns of part and name. The first that matches a fault counts."""

_LEVELS: tuple[tuple[str, Level], ...] = (
    ("env-check libraries.*", Level.INSTALLATION),
    ("env-check cameras.contrast_min", Level.INSTALLATION),
    ("env-check joints.count", Level.SIMULATION),
    ("env-check joints.mapped", Level.SIMULATION),
    ("env-check joints.*", Level.ONE_ARM),
    ("env-check tracking.*", Level.ONE_ARM),
    ("env-check control.stopped", Level.ONE_ARM),
    ("env-check contacts.sine", Level.ONE_ARM),
    ("env-check *", Level.SIMULATION),
    ("plan left_arm.*", Level.ONE_ARM),
    ("plan right_arm.*", Level.ONE_ARM),
    ("plan *", Level.BOTH_ARMS),
    ("carry *", Level.BOTH_ARMS),
    ("recordings *", Level.DATA),
    ("policy *", Level.POLICY),
    ("results env-check *", Level.ONE_ARM),
    ("results plan *", Level.BOTH_ARMS),
    ("results carry *", Level.BOTH_ARMS),
    ("results teleop-record *", Level.DATA),
)
"""(pattern of part and name, level); the first that matches counts, else the highest."""

_FIRST = (
    "env-check libraries.unfit",
    "env-check joints.count",
    "env-check model.agreement_max",
    "env-check contacts.home",
    "env-check joints.mapped",
    "env-check joints.reached",
    "plan engines.agreement",
    "plan closed_chain.carries_rate",
    "carry success_rate",
)
"""Which of several faults of a level is looked at first; the others keep their order."""

_STAGES = {"recordings": "teleop-record", "policy": "train-act"}
"""{part: stage whose artefacts it examines}; other parts bear the name of their stage."""


@dataclass(frozen=True)
class Fault:
    """A fault and its remedy.

    Attributes:
        part: Part of the examination that found it.
        name: Check, fault of an episode, state of a stage, or "error".
        level: Where it lies.
        count: Times that it was found, for example in as many episodes.
        follows: "part: name" of its cause among the faults; "" for a cause.
        stage: Stage that it is about, or "".
    """

    part: str
    name: str
    detail: str
    remedy: str | None
    level: Level
    count: int = 1
    follows: str = ""
    stage: str = ""

    @property
    def key(self) -> str:
        """Part and name, for patterns."""
        return f"{self.part} {self.name}"

    @property
    def title(self) -> str:
        """Part and name, for people."""
        return f"{self.part}: {self.name}"

    @property
    def trouble(self) -> str:
        """Name of the first row of the catalogue that this fault means, or ""."""
        own_name = self.name.rpartition("_arm.")[2].rpartition("_arms.")[2]
        signs = (
            check(_STAGES.get(self.part, self.part), own_name),
            episode_fault(self.name),
        )
        shown = (row.name for row in TROUBLES.values() if any(map(row.is_shown_by, signs)))
        return next(shown, "")


def level_of(part: str, name: str, *, environment: bool = False) -> Level:
    """Return the level of a fault; `environment`: something is missing on the machine."""
    if environment:
        return Level.INSTALLATION
    key = f"{part} {name}"
    return next((level for pattern, level in _LEVELS if fnmatchcase(key, pattern)), Level.POLICY)


def diagnose(faults: Iterable[Fault], upstream: Mapping[str, Sequence[str]]) -> list[Fault]:
    """Return the faults from below, each once, with the cause that it follows from.

    Args:
        faults: In the order in which they were found.
        upstream: {stage: the stages that it stands on, directly or not}.
    """
    ordered = sorted(_merged(faults), key=_place)
    diagnosed: list[Fault] = []
    for fault in ordered:
        cause = next((c for c in diagnosed if _causes(c, fault, upstream)), None)
        if cause is not None:
            fault = replace(fault, follows=cause.follows or cause.title)
        diagnosed.append(fault)
    return diagnosed


def _place(fault: Fault) -> tuple[int, bool, int]:
    """Return the key to sort by: present measurements before earlier results."""
    rank = _FIRST.index(fault.key) if fault.key in _FIRST else len(_FIRST)
    return fault.level, fault.part == "results", rank


def _merged(faults: Iterable[Fault]) -> list[Fault]:
    """Return one fault for those of a part that have one name, such as that of each episode."""
    groups: dict[tuple[str, str], list[Fault]] = {}
    for fault in faults:
        groups.setdefault((fault.part, fault.name), []).append(fault)
    merged: list[Fault] = []
    for group in groups.values():
        first = group[0]
        if len(group) > 1:
            others = [other.detail.partition(":")[0] for other in group[1:]]
            detail = f"{first.detail}; the same in {shortened(others, 3)}"
            first = replace(first, detail=detail, count=len(group))
        merged.append(first)
    return merged


def _causes(cause: Fault, fault: Fault, upstream: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a fault can follow from another one that lies below it."""
    if cause.detail == fault.detail and cause.part != fault.part:
        return True  # what ended one part ends another
    if fault.part == "results":
        stages = (fault.stage, *upstream.get(fault.stage, ()))
        stage_of_cause = _STAGES.get(cause.part, cause.stage or cause.part)
        # An earlier result makes later ones stale; why they failed, it does not tell.
        can_follow = cause.part != "results" or fault.name.endswith(" is stale")
        return can_follow and stage_of_cause in stages
    effects = next((e for pattern, e in _EFFECTS if fnmatchcase(cause.key, pattern)), ())
    return any(fnmatchcase(fault.key, pattern) for pattern in effects)


def as_lines(faults: Sequence[Fault]) -> list[str]:
    """Return the causes from below, each with its consequences."""
    causes = [fault for fault in faults if not fault.follows]
    if not causes:
        return ["", "no known fault found"]
    following_n = len(faults) - len(causes)
    lines = ["", _summary(len(causes), following_n)]
    for cause in causes:
        followers = [fault.title for fault in faults if fault.follows == cause.title]
        lines += ["", f"{LEVELS[cause.level].name}: {cause.title}: {cause.detail}"]
        lines.append(f"  remedy: {cause.remedy or 'see the message'}")
        if cause.trouble:
            lines.append(f"  explained by: minidual doctor --explain {cause.trouble}")
        if followers:
            lines.append(f"  follows from it: {', '.join(followers)}")
    return lines


def _summary(causes_n: int, following_n: int) -> str:
    text = "1 cause" if causes_n == 1 else f"{causes_n} causes, mend the first one first"
    if not following_n:
        return text
    return f"{text}; {following_n} more {'fault follows' if following_n == 1 else 'faults follow'}"
