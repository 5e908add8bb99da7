"""Pictures of plans: paths seen from above and from the side, and where the time goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from minidual.motion.result import PHASES
from minidual.robot.constants import ARMS, Array
from minidual.robot.kinematics import Kinematics
from minidual.trials.planning.evaluate import Outcome

_ARM_COLOURS = {"left": "#1b6ca8", "right": "#d9822b"}
_PHASE_COLOURS = ("#9aa5b1", "#4c78a8", "#72b7b2", "#f2cf5b", "#e45756", "#b279a2", "#54a24b")
_OBSTACLE, _EDGE, _TABLE = "#c9ced6", "#7b8794", "#f4f1ea"
_TITLES = {"left_arm": "left arm (7 joints)", "right_arm": "right arm (7 joints)", "both_arms": "both arms (14 joints)"}


def _new_figure(columns: int, rows: int, width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def write_paths(outcomes: Mapping[str, Sequence[Outcome]], path: Path) -> None:
    """Draw one solved query of each group, the hardest by path length: top view over side view."""
    chosen = {
        group: max(solved, key=lambda o: (not o.result.direct, o.result.trajectory.duration_s))
        for group, done in outcomes.items()
        if (solved := [o for o in done if o.result is not None])
    }
    if not chosen:
        return
    figure, axes = _new_figure(len(chosen), 2, 4.6 * len(chosen), 7.6)
    for column, (group, outcome) in enumerate(chosen.items()):
        for row, (horizontal, vertical) in enumerate(((1, 0), (1, 2))):
            axis = axes[row, column]
            _draw_view(axis, outcome, horizontal, vertical)
            if row == 0:
                duration = outcome.result.trajectory.duration_s
                axis.set_title(
                    f"{_TITLES[group]}\nquery {outcome.query.index}: planned and proven in "
                    f"{outcome.total_s * 1e3:.0f} ms, driven in {duration:.2f} s",
                    fontsize=9,
                )
    axes[0, 0].legend(loc="lower left", fontsize=8, framealpha=0.9)
    figure.suptitle("Tool paths among obstacles: from above, and from behind the robot", fontsize=12)
    figure.savefig(path)


def _draw_view(axis: Any, outcome: Outcome, horizontal: int, vertical: int) -> None:
    from matplotlib.patches import Polygon

    result = outcome.result
    assert result is not None
    kinematics = Kinematics()
    for shape in outcome.query.scene.obstacles:
        outline = _silhouette(shape)[:, [horizontal, vertical]]
        is_table = shape.name == "table"
        axis.add_patch(
            Polygon(
                _hull(outline),
                closed=True,
                facecolor=_TABLE if is_table else _OBSTACLE,
                edgecolor=_EDGE,
                linewidth=0.8,
                zorder=0 if is_table else 2,
                alpha=1.0 if is_table else 0.85,
            )
        )
    q = result.trajectory.q
    stages = ((0, 0.30, 1.5), (len(q) - 1, 0.85, 2.2))
    for index, alpha, width in stages:
        for arm in ARMS:
            chain = _stick(kinematics, q[index], arm)
            axis.plot(
                chain[:, horizontal],
                chain[:, vertical],
                "-o",
                color=_ARM_COLOURS[arm],
                alpha=alpha,
                lw=width,
                ms=3,
                zorder=4,
                solid_capstyle="round",
            )
    rows = np.linspace(0, len(q) - 1, 160).astype(int)
    tips = np.array([[T[:3, 3] for T in kinematics.tcp_poses(q[k])] for k in rows])
    for index, arm in enumerate(ARMS):
        track = tips[:, index]
        axis.plot(
            track[:, horizontal],
            track[:, vertical],
            color=_ARM_COLOURS[arm],
            lw=2.0,
            ls=(0, (2, 1)),
            zorder=5,
            label=f"{arm} tool",
        )
        axis.plot(*track[0, [horizontal, vertical]], "o", mfc="white", mec=_ARM_COLOURS[arm], ms=6, zorder=6)
        axis.plot(*track[-1, [horizontal, vertical]], "*", color=_ARM_COLOURS[arm], ms=11, zorder=6)
    axis.set_aspect("equal")
    axis.set_xlim(0.85, -0.85)  # left arm on the left, as seen by someone behind the robot
    axis.set_ylim((-0.25, 1.0) if vertical == 0 else (-0.08, 1.05))
    axis.set_xlabel("y [m]")
    axis.set_ylabel("x [m]" if vertical == 0 else "z [m]")
    axis.grid(color="#e4e7eb", lw=0.6, zorder=1)
    axis.set_axisbelow(True)


def _stick(kinematics: Kinematics, q: Array, arm: str) -> Array:
    """Return the joint origins and the tcp of one arm (9, 3) [m]."""
    pin.forwardKinematics(kinematics.model, kinematics.data, q)
    first = 1 + 7 * ARMS.index(arm)
    origins = [kinematics.data.oMi[j].translation for j in range(first, first + 7)]
    base = kinematics.model.jointPlacements[first].translation * np.array([1.0, 1.0, 0.0])
    tip = kinematics.tcp_poses(q)[ARMS.index(arm)][:3, 3]
    return np.array([base, *(np.array(o) for o in origins), tip])


def _silhouette(shape: Shape) -> Array:
    """Return points (n, 3) in the world whose hull is the shape, for drawing."""
    match shape:
        case Box():
            half = 0.5 * np.array(shape.size_m)
            points = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T * half
        case Cylinder():
            points = _rings(shape.radius_m, [-0.5 * shape.length_m, 0.5 * shape.length_m])
        case Capsule():
            end = np.array([0.0, 0.0, 0.5 * shape.length_m])
            points = np.vstack([_ball(shape.radius_m) - end, _ball(shape.radius_m) + end])
        case Sphere():
            points = _ball(shape.radius_m)
        case Mesh():
            points = np.vstack(shape.vertices())
    T = shape.T_parent_shape
    return points @ T[:3, :3].T + T[:3, 3]


def _rings(radius: float, heights: Sequence[float]) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([circle, np.full(len(angle), z)]) for z in heights])


def _ball(radius: float) -> Array:
    polar = np.linspace(0.0, np.pi, 17)
    return np.vstack([_rings(radius * float(np.sin(p)), [radius * float(np.cos(p))]) for p in polar])


def _hull(points: Array) -> Array:
    from scipy.spatial import ConvexHull

    return points[ConvexHull(points).vertices]


def write_times(
    outcomes: Mapping[str, Sequence[Outcome]], path: Path, median_max_s: Mapping[str, float | None]
) -> None:
    """Draw the distribution of the planning time of each group beside the limit of its median, and the phases of it."""
    figure, axes = _new_figure(2, 1, 11.0, 4.2)
    spread, shares = axes[0]
    groups = list(outcomes)
    for row, group in enumerate(groups):
        solved = np.array([o.total_s for o in outcomes[group] if o.ok]) * 1e3
        failed = np.array([o.total_s for o in outcomes[group] if not o.ok]) * 1e3
        jitter = np.random.default_rng(row).uniform(-0.18, 0.18, len(solved))
        spread.plot(solved, row + jitter, "o", ms=5, alpha=0.6, color="#4c78a8", mew=0)
        spread.plot(failed, np.full(len(failed), row), "x", ms=8, color="#e45756")
        if len(solved):
            median = float(np.median(solved))
            spread.plot([median, median], [row - 0.3, row + 0.3], color="#1f2933", lw=2)
            spread.annotate(f"{median:.1f} ms", (median, row + 0.33), ha="center", va="bottom", fontsize=9)
        limit = median_max_s[group]
        if limit is not None:
            spread.plot([limit * 1e3] * 2, [row - 0.3, row + 0.3], color="#e45756", lw=1.6, ls="--")
    spread.set_xscale("log")
    spread.set_yticks(range(len(groups)), groups)
    spread.set_ylim(-0.6, len(groups) - 0.3)
    spread.set_xlabel("goal in to proven trajectory out [ms]; bar: median, dashed: its limit")
    spread.grid(axis="x", which="both", color="#e4e7eb", lw=0.6)
    spread.set_axisbelow(True)
    left = np.zeros(len(groups))
    for colour, phase in zip(_PHASE_COLOURS, PHASES, strict=True):
        if phase == "scene":
            continue
        medians = (
            np.array(
                [
                    np.median([o.result.times_s[phase] for o in outcomes[g] if o.result is not None] or [0.0])
                    for g in groups
                ]
            )
            * 1e3
        )
        shares.barh(groups, medians, left=left, color=colour, label=phase, height=0.55)
        left += medians
    shares.set_xlabel("median time of each phase [ms]")
    shares.legend(fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.18), frameon=False)
    for axis in (spread, shares):
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
