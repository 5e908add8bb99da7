"""Offers of the hands' stages (see `Stage`): reach, descend, close, open, retreat, home."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.seeds import subseed
from minidual.motion.timing import DT_S
from minidual.robot.pair import SIDES, Array, group_of
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.motions import free, off, straight
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Tools, candidate_error
from minidual.skills.states import CLOSED, OPEN, Arms, Segment, State, moved, still

_ATTEMPTS = 5
"""Postures tried per grip."""
_RESTED_M = 0.004
"""Distance by which a hand under impedance lowers an object onto its support."""
_SHORTER = (1.0, 0.6)
"""Shares of the retreat height to try."""


@dataclass(frozen=True, eq=False)
class Grip:
    """One way to hold the object: {arm: T_object_tcp (4, 4)}."""

    label: str
    grasps: Mapping[str, Array]
    cost: float = 0.0


def reach(
    arms: Arms,
    grips: Sequence[Grip],
    handled: Mapping[str, str],
    start: State,
    tools: Tools,
) -> Iterator[Offer]:
    """Yield free motions of open hands to the approach height over every grip.

    Args:
        arms: Hands that move.
        grips: Ways to hold the objects.
        handled: {arm: object}.
        start: State before.
        tools: Of the search.
    """
    _require_open_chain(start)
    start = replace(start, handled={**start.handled, **handled})
    scene = tools.scene(start)
    for grip in sorted(grips, key=lambda grip: grip.cost):
        for attempt in range(_ATTEMPTS):
            try:
                yield _over(arms, grip, attempt, start, tools, scene)
            except PlanningError as error:
                yield candidate_error(error, grip.label)
                break  # further postures would fail too


def _over(
    arms: Arms,
    grip: Grip,
    attempt: int,
    start: State,
    tools: Tools,
    scene: PlanningScene,
) -> Candidate:
    """Return a free motion to the approach height over a grip, or raise PlanningError."""
    grasps = {arm: grip.grasps[arm] for arm in arms}
    at = {arm: start.objects[start.object_of(arm)] @ T for arm, T in grasps.items()}
    rise_m = off(at, PHASES["approach"].rise_m)
    over = {arm: moved(T, rise_m) for arm, T in at.items()}
    plan = tools.planner.plan_to_poses(
        group_of(arms),
        start.q,
        over,
        scene=scene,
        seed=subseed(tools.seed, "pipeline/approach", attempt),
    )
    end = replace(
        start.opened(arms, OPEN),
        q=plan.trajectory.q[-1],
        reached={**start.reached, **grasps},
    )
    segment = free(tools, "approach", end, plan, scene)
    label = grip.label if attempt == 0 else f"{grip.label}, posture {attempt + 1}"
    return Candidate(label, grip.cost + 0.5 * attempt, end, (segment,))


def descend(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield the straight motion to the grasps."""
    targets = {arm: start.objects[start.object_of(arm)] @ start.reached[arm] for arm in arms}
    segment = straight(tools, "descend", start, targets, tools.scene(start, touching=arms))
    yield Candidate("", 0.0, replace(start, q=segment.trajectory.q[-1]), (segment,))


def close(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Close the hands; from then on they hold the object."""
    newly_held = {arm: start.reached[arm] for arm in arms}
    end = replace(
        start.opened(arms, CLOSED),
        held_by={**start.held_by, **newly_held},
        reached={arm: T for arm, T in start.reached.items() if arm not in arms},
    )
    joins_another = end.closed_chain and len(start.held_by) > 0
    soft = arms if joins_another else ()
    duration_s = tools.fingers_s + PHASES["close"].hold_s
    closing = still("close", start.q, duration_s, end.openings, soft=soft)
    felt = still("close", start.q, DT_S, end.openings, kept_by=arms, soft=soft)
    yield Candidate("", 0.0, end, (closing, felt))


def open_hands(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Open hands; the object stays in place or with the other hand. `by_force` lowers it first."""
    _require_support(arms, start)
    kept = {arm: T for arm, T in start.held_by.items() if arm not in arms}
    kept_by = () if start.rests else tuple(kept)
    lowers = tools.by_force and start.rests and not start.closed_chain
    soft = arms if lowers else kept_by
    segments: list[Segment] = []
    q = start.q
    if lowers:
        lowering = _lowered(arms, start, tools)
        segments.append(lowering)
        q = lowering.trajectory.q[-1]
    end = replace(start.opened(arms, OPEN), held_by=kept, q=q)
    settle = still("settle", q, PHASES["settle"].hold_s, start.openings, soft=soft)
    opens = still(
        "open",
        q,
        PHASES["open"].hold_s,
        end.openings,
        kept_by=kept_by,
        soft=soft,
    )
    # The payload ends where the scene says that the hand holds nothing. A supported object is no
    # payload already while it settles: by force, the hand sinks to q only without payload. Else the
    # other hand carries the object once this one opens.
    without_object = tools.scene(end, touching=arms)
    if start.rests:
        settle = replace(settle, scene=without_object)
    else:
        opens = replace(opens, scene=without_object)
    yield Candidate("", 0.0, end, (*segments, settle, opens))


def _require_support(arms: Arms, start: State) -> None:
    """Raise CandidateError if hands hold nothing, or their object would fall."""
    empty = [arm for arm in arms if arm not in start.held_by]
    if empty:
        raise CandidateError("not_held", f"the {empty[0]} hand holds nothing to let go")
    kept_objects = {start.object_of(arm) for arm in start.held_by if arm not in arms}
    would_fall = any(start.object_of(arm) not in kept_objects for arm in arms)
    if not start.rests and would_fall:
        raise CandidateError("would_fall", "the object is in the air and no other hand holds it")


def _lowered(arms: Arms, start: State, tools: Tools) -> Segment:
    """Return the motion that presses the held object onto its support."""
    tips = tools.planner.kinematics.tcp_poses(start.q)
    down_m = np.array([0.0, 0.0, -_RESTED_M])
    targets = {arm: moved(tips[SIDES.index(arm)], down_m) for arm in arms}
    segment = straight(tools, "lower", start, targets, tools.scene(start, resting=True))
    return replace(segment, soft=arms)


def retreat(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield straight motions away from the released object."""
    scene = tools.scene(start, touching=arms)
    poses = tools.planner.kinematics.tcp_poses(start.q)
    tips = {arm: T for arm, T in zip(SIDES, poses, strict=True) if arm in arms}
    for share in _SHORTER:
        height_m = share * PHASES["retreat"].rise_m
        label = f"by {100 * height_m:.0f} cm"
        shift_m = off(tips, height_m)
        targets = {arm: moved(T, shift_m) for arm, T in tips.items()}
        try:
            segment = straight(tools, "retreat", start, targets, scene)
        except PlanningError as error:
            yield candidate_error(error, label)
            continue
        yield Candidate(label, 1.0 - share, replace(start, q=segment.trajectory.q[-1]), (segment,))


def home(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield the free motion of some arms, with their objects, home."""
    _require_open_chain(start)
    scene = tools.scene(start)
    group = group_of(arms)
    robot = tools.planner.robot
    plan = tools.planner.plan_to_joints(
        group,
        start.q,
        robot.home[robot.groups[group]],
        scene=scene,
        seed=tools.seed,
    )
    segment = free(tools, "home", start, plan, scene)
    yield Candidate("", 0.0, replace(start, q=plan.trajectory.q[-1]), (segment,))


def _require_open_chain(start: State) -> None:
    if start.closed_chain:
        raise CandidateError(
            "closed_chain",
            "both hands hold the object; a free motion would tear it from them",
        )
