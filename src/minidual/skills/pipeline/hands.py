"""Offers of the hands' stages (see `Stage`): reach, descend, close, insert, open, retreat, home."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.seeds import subseed
from minidual.motion.api import PlanResult
from minidual.motion.linear import TIP_LIMITS, Line, LinearPlanner
from minidual.motion.timing import DT_S
from minidual.robot.pair import SIDES, Array, group_of, pose
from minidual.robot.trajectory import Trajectory
from minidual.skills.phases import CLOSED, OPEN, PHASES, Arms, Segment, State, moved, still
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Tools, candidate_error

_ATTEMPTS = 5  # postures tried per grip
_TIP_MAX_M_PER_S = 1.6  # hand speed of free motions; the supervisor stops the arms at 1.7 m/s
_TIPS_EVERY = 8
_SEARCH_M = 0.0035  # radius and pitch of the spiral
_SEARCH_PITCH_M = 0.0012
_DRIVEN_M = 0.020  # further by force: into another object, down to rest
_RESTED_M = 0.004
_CRAWL_RATIO = 2.5  # time of a straight way over that of the hands alone; near singular postures it is 5 or more
_SHORTER = (1.0, 0.6)  # shares of the retreat height to try


@dataclass(frozen=True, eq=False)
class Grip:
    """One way to hold the object: {arm: T_object_tcp (4, 4)}."""

    label: str
    grasps: Mapping[str, Array]
    cost: float = 0.0


def reach(
    arms: Arms,
    grips: Sequence[Grip],
    about: Mapping[str, str],
    start: State,
    tools: Tools,
) -> Iterator[Offer]:
    """Yield free motions of open hands to the approach height over every grip, of the objects in `about`, by arm."""
    _require_open_chain(start)
    start = replace(start, about={**start.about, **about})
    scene = tools.scene(start)
    for grip in sorted(grips, key=lambda grip: grip.cost):
        grasps = {arm: grip.grasps[arm] for arm in arms}
        at = {arm: start.objects[start.object_of(arm)] @ T for arm, T in grasps.items()}
        over = {arm: moved(T, off(at, PHASES["approach"].rise_m)) for arm, T in at.items()}
        for attempt in range(_ATTEMPTS):
            seed = subseed(tools.seed, "pipeline/approach", attempt)
            try:
                plan = tools.planner.plan_to_poses(
                    group_of(arms),
                    start.q,
                    over,
                    scene=scene,
                    seed=seed,
                )
            except PlanningError as error:
                yield candidate_error(error, grip.label)
                break  # further postures would fail too
            end = replace(
                start.opened(arms, OPEN),
                q=plan.trajectory.q[-1],
                reached={**start.reached, **grasps},
            )
            segment = free(tools, "approach", end, plan, scene)
            label = grip.label if attempt == 0 else f"{grip.label}, posture {attempt + 1}"
            yield Candidate(label, grip.cost + 0.5 * attempt, end, (segment,))


def descend(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield the straight motion to the grasps."""
    targets = {arm: start.objects[start.object_of(arm)] @ start.reached[arm] for arm in arms}
    segment = straight(tools, "descend", start, targets, tools.scene(start, touching=arms))
    yield Candidate("", 0.0, replace(start, q=segment.trajectory.q[-1]), (segment,))


def close(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Close the hands; from then on they hold the object."""
    held = {**start.held_by, **{arm: start.reached[arm] for arm in arms}}
    left = {arm: T for arm, T in start.reached.items() if arm not in arms}
    end = replace(start.opened(arms, CLOSED), held_by=held, reached=left)
    soft = arms if end.closed_chain and start.held_by else ()
    closing = still(
        "close",
        start.q,
        tools.fingers_s + PHASES["close"].hold_s,
        end.openings,
        soft=soft,
    )
    felt = still("close", start.q, DT_S, end.openings, kept_by=arms, soft=soft)
    yield Candidate("", 0.0, end, (closing, felt))


def insert(
    arms: Arms,
    way: Sequence[Array],
    what: str,
    into: str,
    start: State,
    tools: Tools,
) -> Iterator[Offer]:
    """A held object touches another one, searches across its y axis, and goes in; `by_force` without search."""
    scene = tools.scene(start).allowing(what, into, "one goes into the other")
    state = start
    segments = list[Segment]()
    (touch, end) = way
    parts = (
        (end @ pose(np.eye(3), (0.0, _DRIVEN_M, 0.0)),)
        if tools.by_force
        else (*_spiral(touch), touch, end)
    )
    for T in parts:
        targets = {arm: T @ start.held_by[arm] for arm in arms}
        segments.append(replace(straight(tools, "insert", state, targets, scene), soft=arms))
        state = replace(state, q=segments[-1].trajectory.q[-1], objects={**start.objects, what: T})
    hold_s = PHASES["insert"].force_s if tools.by_force else PHASES["insert"].hold_s
    yield Candidate(
        "",
        0.0,
        state,
        (*segments, still("settle", state.q, hold_s, state.openings, soft=arms)),
    )


def _spiral(T: Array) -> Iterator[Array]:
    for k in range(int(np.pi * (_SEARCH_M / _SEARCH_PITCH_M) ** 2) + 1):
        angle = np.sqrt(4.0 * np.pi * k)
        radius_m = _SEARCH_PITCH_M * np.sqrt(k / np.pi)
        yield T @ pose(np.eye(3), (radius_m * np.cos(angle), 0.0, radius_m * np.sin(angle)))


def open_hands(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Open hands; the object stays in place or with the other hand. `by_force` lowers it first."""
    if missing := [arm for arm in arms if arm not in start.held_by]:
        raise CandidateError("not_held", f"the {missing[0]} hand holds nothing to let go")
    held = {arm: T for arm, T in start.held_by.items() if arm not in arms}
    kept = {start.object_of(arm) for arm in held}
    if not start.rests and any(start.object_of(arm) not in kept for arm in arms):
        raise CandidateError("would_fall", "the object is in the air and no other hand holds it")
    kept_by = () if start.rests else tuple(held)
    soft = ()
    q = start.q
    down = ()
    if tools.by_force and start.rests and not start.closed_chain:
        poses = tools.planner.kinematics.tcp_poses(start.q)
        soft = arms
        deeper = {
            arm: moved(poses[SIDES.index(arm)], np.array([0.0, 0.0, -_RESTED_M])) for arm in arms
        }
        down = (
            replace(
                straight(tools, "lower", start, deeper, tools.scene(start, resting=True)),
                soft=soft,
            ),
        )
        q = down[-1].trajectory.q[-1]
    end = replace(start.opened(arms, OPEN), held_by=held, q=q)
    settle = still("settle", q, PHASES["settle"].hold_s, start.openings, soft=kept_by or soft)
    opens = still(
        "open",
        q,
        PHASES["open"].hold_s,
        end.openings,
        kept_by=kept_by,
        soft=kept_by or soft,
    )
    # What rests is no load; by force, the hand sinks to q as soon as it holds nothing. Else the other hand bears it.
    left = tools.scene(end, touching=arms)
    settle, opens = (
        (replace(settle, scene=left), opens)
        if start.rests
        else (settle, replace(opens, scene=left))
    )
    yield Candidate("", 0.0, end, (*down, settle, opens))


def retreat(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield straight motions away from the released object."""
    scene = tools.scene(start, touching=arms)
    tips = {
        arm: T
        for arm, T in zip(SIDES, tools.planner.kinematics.tcp_poses(start.q), strict=True)
        if arm in arms
    }
    for share in _SHORTER:
        height = share * PHASES["retreat"].rise_m
        label = f"by {100 * height:.0f} cm"
        targets = {arm: moved(T, off(tips, height)) for arm, T in tips.items()}
        try:
            segment = straight(tools, "retreat", start, targets, scene)
        except PlanningError as error:
            yield candidate_error(error, label)
            continue
        yield Candidate(label, 1.0 - share, replace(start, q=segment.trajectory.q[-1]), (segment,))


def home(arms: Arms, start: State, tools: Tools) -> Iterator[Offer]:
    """Yield the free motion of some arms, and what they hold, home."""
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
    yield Candidate(
        "",
        0.0,
        replace(start, q=plan.trajectory.q[-1]),
        (free(tools, "home", start, plan, scene),),
    )


def _require_open_chain(start: State) -> None:
    if start.closed_chain:
        raise CandidateError(
            "closed_chain",
            "both hands hold the object; a free motion would tear it from them",
        )


def free(tools: Tools, phase: str, state: State, plan: PlanResult, scene: PlanningScene) -> Segment:
    """Return a planned free motion, slowed to `_TIP_MAX_M_PER_S`, of hands that hold something to the limits of a carry."""
    motion = plan.trajectory
    carry = PHASES["carry"].limits or TIP_LIMITS
    every_s = _TIPS_EVERY * plan.trajectory.dt_s
    tips = np.array([tools.planner.kinematics.tcp_poses(q) for q in motion.q[::_TIPS_EVERY]])
    speeds = np.diff(tips[:, :, :3, 3], axis=0) / every_s
    ratio = max(1.0, np.linalg.norm(speeds, axis=2).max(initial=0.0) / _TIP_MAX_M_PER_S)
    for hand in map(SIDES.index, state.held_by):
        way_m = max((Line(*ends).length_m for ends in pairwise(tips[:, hand])), default=0.0)
        most = np.linalg.norm(np.diff(speeds[:, hand], axis=0), axis=1).max(initial=0.0) / every_s
        ratio = max(
            ratio,
            way_m / every_s / carry.speed_m_per_s,
            np.sqrt(most / carry.acceleration_m_per_s2),
        )
    motion = Trajectory(
        ratio * motion.times,
        motion.q,
        motion.v / ratio,
        motion.a / ratio**2,
        motion.group,
    )
    return Segment(phase, motion, state.openings, scene, plan.verification)


def straight(
    tools: Tools,
    phase: str,
    state: State,
    targets: Mapping[str, Array],
    scene: PlanningScene,
) -> Segment:
    """Return the proven straight motion of hands to {arm: T_world_tcp (4, 4)}, or raise PlanningError."""
    engines = tools.planner.engines(scene)
    limits = PHASES[phase].limits
    linear = LinearPlanner(kinematics=tools.planner.kinematics)
    move = linear.plan(group_of(targets), state.q, targets, engines, limits=limits)
    tips = tools.planner.kinematics.tcp_poses(state.q)
    way_m = max(Line(tips[SIDES.index(arm)], T).length_m for arm, T in targets.items())
    speed = (limits or TIP_LIMITS).speed_m_per_s
    acceleration = (limits or TIP_LIMITS).acceleration_m_per_s2
    alone_s = way_m / speed + speed / acceleration
    takes_s = move.trajectory.duration_s
    if takes_s > _CRAWL_RATIO * alone_s:
        what = f"{phase}: {way_m:.2f} m straight in {takes_s:.1f} s instead of {alone_s:.1f}"
        raise CandidateError("crawls", f"{what}: the arms pass a nearly singular posture")
    return Segment(phase, move.trajectory, state.openings, scene, move.verification)


def off(tips: Mapping[str, Array], height_m: float) -> Array:
    """Return the shift (3,) [m] against the approach axes of hands at {arm: T_world_tcp}."""
    back = -np.sum([T[:3, 2] for T in tips.values()], axis=0)
    norm = float(np.linalg.norm(back))
    return height_m * (back / norm if norm > 0.1 else np.array([0.0, 0.0, 1.0]))
