"""Show plans and their times."""

import itertools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from minidual.collision.engines import add_body
from minidual.collision.scene import TABLE, PlanningScene
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.motion.api import PLAN_PHASES
from minidual.plant.addresses import map_joints
from minidual.plant.contact import GROUP_COLLISION, GROUP_MARKER, GROUP_VISUAL
from minidual.plant.model import build_spec
from minidual.plant.render import free_camera, off_screen
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from minidual.show.figures.canvas import INK, LIMIT, new_figure, sheet
from minidual.show.view import View
from minidual.show.view.overlay import Overlay
from minidual.show.watch import tcp_preview
from minidual.trials.planning.evaluate import QueryOutcome

_OBSTACLE_RGBA = [0.78, 0.42, 0.25, 1.0]
_HELD_RGBA = [0.15, 0.6, 0.4, 1.0]
_LOOK = {"contype": 0, "conaffinity": 0, "density": 0.0, "group": GROUP_VISUAL}
_TIMED = tuple(phase for phase in PLAN_PHASES if phase != "scene")
_LOOK_S = 1.0
"""Pause after each round."""
Outcomes = Mapping[str, Sequence[QueryOutcome]]
"""By group."""


def scene_model(config: SceneConfig, scene: PlanningScene) -> mujoco.MjModel:
    """Return the visual model with the scene's obstacles and held shapes, hiding task objects."""
    spec = build_spec(config, scene.robot, visuals=True)
    for name in config.objects:
        for geom in spec.body(name).geoms:
            geom.rgba = [0.0, 0.0, 0.0, 0.0]
    for shape in (shape for shape in scene.obstacles if shape != TABLE):
        add_body(spec, spec.worldbody, shape, "shown_", rgba=_OBSTACLE_RGBA, **_LOOK)
    for held in scene.attached:
        add_body(spec, spec.body(held.link), held.shape, "shown_", rgba=_HELD_RGBA, **_LOOK)
    return spec.compile()


class Poser:
    """Places the arms in the visual model, grippers open."""

    def __init__(self, config: SceneConfig, scene: PlanningScene) -> None:
        robot = scene.robot
        model = scene_model(config, scene)
        self.model = model
        self.data = mujoco.MjData(model)
        self.kinematics = Kinematics(robot)
        self._joints = map_joints(model, robot.joint_names, torque=True).qpos
        self.data.qpos[map_joints(model, robot.finger_joint_names, torque=False).qpos] = (
            robot.hand.travel_m
        )

    def place(self, q: Array) -> mujoco.MjData:
        """Return the data with the arms at q (n,)."""
        self.data.qpos[self._joints] = q
        mujoco.mj_kinematics(self.model, self.data)
        return self.data


def play(
    view: View,
    poser: Poser,
    trajectory: Trajectory,
    title: str,
    *,
    rounds_n: int | None,
    note: str = "",
) -> None:
    """Play a plan in real time, not simulated, with TCP paths and end posture.

    `rounds_n` None repeats until the view is closed.
    """
    end = poser.place(trajectory.q[-1]).qpos.copy()
    words = Overlay(title=title, mode="moveit", source="planner", state="played, not simulated")
    words = words._replace(
        preview=tcp_preview(poser.kinematics, trajectory.q)._replace(ghosts=(end,)),
    )
    view.open(poser.model)
    for done in itertools.count(1):
        status = ", ".join(
            text
            for text in (note, f"{trajectory.duration_s:.2f} s of motion, round {done}")
            if text
        )
        began = time.monotonic()
        t = 0.0
        while view.alive and t < trajectory.duration_s + _LOOK_S:
            t = time.monotonic() - began
            if view.due():
                shown_s = min(t, trajectory.duration_s)
                view.update(
                    poser.place(trajectory.sample(t)[0]),
                    words._replace(time_s=shown_s, status=status),
                )
            time.sleep(0.005)
        if done == rounds_n or not view.alive:
            return


def play_queries(view: View | None, config: SceneConfig, outcomes: Outcomes) -> None:
    """Play each group's first solved query once; no-op without a view."""
    for group, done in outcomes.items():
        first = next((o for o in done if o.result is not None), None)
        if view is not None and first is not None and first.result is not None:
            title = f"plan, {group}, query {first.query.index}"
            note = f"planned in {1e3 * first.total_s:.0f} ms"
            play(
                view,
                Poser(config, first.query.scene),
                first.result.trajectory,
                title,
                rounds_n=1,
                note=note,
            )


def write_paths(path: Path, config: SceneConfig, outcomes: Outcomes) -> None:
    """Draw each group's longest solved trajectory, if possible one that needed a search."""
    shown: list[tuple[str, Any]] = []
    for group, done in outcomes.items():
        if solved := [(o, o.result) for o in done if o.result is not None]:
            o, result = max(
                solved,
                key=lambda pair: (not pair[1].direct, pair[1].trajectory.duration_s),
            )
            title = f"{group}, query {o.query.index}: planned in {1e3 * o.total_s:.0f} ms, lasts {result.trajectory.duration_s:.2f} s"
            shown += zip(
                (title, ""),
                _renders(config, o.query.scene, result.trajectory),
                strict=True,
            )
    if shown:
        sheet(
            shown,
            2,
            path,
            title="Pale: start and midway. Solid: end. Lines: paths of the hands.",
            width_in=5.0,
        )


def write_picture(
    path: Path,
    config: SceneConfig,
    scene: PlanningScene,
    trajectory: Trajectory,
    title: str,
) -> None:
    """Draw a plan from two cameras, solid at the end, pale before."""
    names = ("from the front corner", "from above, the arms' bases on the left")
    pictures = list(zip(names, _renders(config, scene, trajectory), strict=True))
    sheet(
        pictures,
        2,
        path,
        title=f"{title}: pale at the start and midway, solid at the end",
        width_in=6.5,
    )


def _renders(config: SceneConfig, scene: PlanningScene, trajectory: Trajectory) -> list[Any]:
    poser = Poser(config, scene)
    cameras = (
        free_camera((0.3, 0.0, 0.25), 2.1, 148.0, -28.0),
        free_camera((0.35, 0.0, 0.1), 2.2, 90.0, -89.0),
    )
    return [_render(poser, trajectory, camera) for camera in cameras]


def _render(poser: Poser, trajectory: Trajectory, camera: mujoco.MjvCamera) -> Any:
    option = mujoco.MjvOption()
    option.geomgroup[GROUP_COLLISION] = option.geomgroup[GROUP_MARKER] = 0
    with off_screen(poser.model, 840, 720, max_geom=20_000) as renderer:
        renderer.update_scene(poser.place(trajectory.q[-1]), camera, scene_option=option)
        for fraction, alpha in ((0.0, 0.35), (1.0 / 3.0, 0.14), (2.0 / 3.0, 0.14)):
            _add_ghost(
                renderer.scene,
                poser,
                trajectory.sample(fraction * trajectory.duration_s)[0],
                option,
                alpha,
            )
        for line in tcp_preview(poser.kinematics, trajectory.q).paths:
            _add_line(renderer.scene, line.points, line.rgb)
        return renderer.render()


def _add_ghost(shown: Any, poser: Poser, q: Array, option: mujoco.MjvOption, alpha: float) -> None:
    before = shown.ngeom
    moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(poser.model, poser.place(q), option, mujoco.MjvPerturb(), moving, shown)
    for geom in shown.geoms[before : shown.ngeom]:
        geom.rgba[3] *= alpha


def _add_line(shown: Any, points: Array, rgb: Sequence[int]) -> None:
    colour = np.array([*(v / 255.0 for v in rgb), 1.0], dtype=np.float32)
    for a, b in itertools.pairwise(points):
        geom = shown.geoms[shown.ngeom]
        mujoco.mjv_initGeom(
            geom,
            int(mujoco.mjtGeom.mjGEOM_CAPSULE),
            np.zeros(3),
            np.zeros(3),
            np.zeros(9),
            colour,
        )
        mujoco.mjv_connector(geom, int(mujoco.mjtGeom.mjGEOM_CAPSULE), 0.006, a, b)
        shown.ngeom += 1


def write_times(outcomes: Outcomes, path: Path, median_max_s: Mapping[str, float | None]) -> None:
    """Draw planning times by group and phase."""
    figure, ((spread, shares),) = new_figure(1, 2, 11.0, 4.2)
    groups = list(outcomes)
    for row, (group, done) in enumerate(outcomes.items()):
        solved, failed = (
            1e3 * np.array([o.total_s for o in done if o.ok is ok]) for ok in (True, False)
        )
        jitter = stream(0, "figure/jitter", row).uniform(-0.18, 0.18, len(solved))
        spread.plot(solved, row + jitter, "o", color="0.5", ms=5, alpha=0.6, mew=0)
        spread.plot(failed, np.full(len(failed), row), "x", ms=8, color=LIMIT)
        ends = [row - 0.3, row + 0.3]
        if len(solved):
            median = float(np.median(solved))
            spread.plot([median, median], ends, color=INK, lw=2)
            spread.annotate(
                f"{median:.1f} ms",
                (median, row + 0.33),
                ha="center",
                va="bottom",
                fontsize=9,
            )
        if (limit := median_max_s[group]) is not None:
            spread.plot([limit * 1e3] * 2, ends, color=LIMIT, lw=1.6, ls="--")
    spread.set_xscale("log", subs=[2, 5])
    spread.xaxis.set_major_formatter("{x:g}")
    spread.xaxis.set_minor_formatter("{x:g}")
    spread.grid(axis="x", which="both", alpha=0.25)
    spread.set_yticks(range(len(groups)), groups)
    spread.set_ylim(-0.6, len(groups) - 0.3)
    spread.set_xlabel(
        "goal in to proven trajectory out [ms]; bar: median; dashed: its limit, if it has one",
    )
    left = np.zeros(len(groups))
    for phase in _TIMED:
        times = (
            [o.result.times_s[phase] for o in outcomes[g] if o.result is not None] for g in groups
        )
        medians = np.array([1e3 * float(np.median(found or [0.0])) for found in times])
        shares.barh(groups, medians, left=left, label=phase, height=0.55)
        left += medians
    shares.set_xlabel("median time of each phase [ms]")
    shares.legend(
        fontsize=8,
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, 1.18),
        frameon=False,
    )
    figure.savefig(path)
