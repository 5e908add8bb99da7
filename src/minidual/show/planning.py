"""Show plans: played in the view, or drawn as pictures."""

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
from minidual.motion.api import PlanResult
from minidual.plant.addresses import map_joints
from minidual.plant.contact import GROUP_COLLISION, GROUP_MARKER, GROUP_VISUAL
from minidual.plant.model import build_spec
from minidual.plant.render import Image, free_camera, off_screen
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from minidual.show.figures.canvas import sheet
from minidual.show.view import View
from minidual.show.view.overlay import Overlay
from minidual.show.watch import tcp_preview
from minidual.trials.planning.evaluate import QueryOutcome

_OBSTACLE_RGBA = [0.78, 0.42, 0.25, 1.0]
_HELD_RGBA = [0.15, 0.6, 0.4, 1.0]
_INVISIBLE_RGBA = [0.0, 0.0, 0.0, 0.0]
_SHOWN_ONLY = {"contype": 0, "conaffinity": 0, "density": 0.0, "group": GROUP_VISUAL}
"""Options of geoms without contacts and mass."""
_PAUSE_S = 1.0
"""After each round."""
_SLEEP_S = 0.005
_PICTURE_SIZE = (840, 720)
_LINE_RADIUS_M = 0.006
_GHOSTS = ((0.0, 0.35), (1.0 / 3.0, 0.14), (2.0 / 3.0, 0.14))
"""(share of the duration, opacity) of the pale postures."""

Outcomes = Mapping[str, Sequence[QueryOutcome]]
"""By group."""


def scene_model(config: SceneConfig, scene: PlanningScene) -> mujoco.MjModel:
    """Return the visual model with the scene's obstacles and held shapes, hiding task objects."""
    spec = build_spec(config, scene.robot, visuals=True)
    for name in config.objects:
        for geom in spec.body(name).geoms:
            geom.rgba = _INVISIBLE_RGBA
    for shape in scene.obstacles:
        if shape != TABLE:
            add_body(spec, spec.worldbody, shape, "shown_", rgba=_OBSTACLE_RGBA, **_SHOWN_ONLY)
    for held in scene.attached:
        link = spec.body(held.link)
        add_body(spec, link, held.shape, "shown_", rgba=_HELD_RGBA, **_SHOWN_ONLY)
    return spec.compile()


class Poser:
    """Places the arms in the visual model, grippers open."""

    def __init__(self, config: SceneConfig, scene: PlanningScene) -> None:
        robot = scene.robot
        self.model = scene_model(config, scene)
        self.data = mujoco.MjData(self.model)
        self.kinematics = Kinematics(robot)
        self._joints = map_joints(self.model, robot.joint_names, torque=True).qpos
        fingers = map_joints(self.model, robot.finger_joint_names, torque=False).qpos
        self.data.qpos[fingers] = robot.hand.travel_m

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
    proven: bool | None = None,
) -> None:
    """Play a plan in real time, not simulated, with TCP paths and end posture.

    Args:
        view: Where it is shown.
        poser: Of the plan's scene.
        trajectory: The plan.
        title: Above the state.
        rounds_n: How often it is played; None repeats until the view is closed.
        note: Shown in the status.
        proven: Whether it is proven free of collisions; None says nothing.
    """
    end_state = poser.place(trajectory.q[-1]).qpos.copy()
    paths = tcp_preview(poser.kinematics, trajectory.q)
    overlay = Overlay(
        title=title,
        source="planner",
        state="played, not simulated",
        plan=plan_words(trajectory.duration_s, proven),
        preview=paths._replace(ghosts=(end_state,)),
    )
    view.open(poser.model)
    for round_n in itertools.count(1):
        status = f"{note}, round {round_n}" if note else f"round {round_n}"
        _play_once(view, poser, trajectory, overlay._replace(status=status))
        if round_n == rounds_n or not view.alive:
            return


def plan_words(duration_s: float, proven: bool | None) -> str:
    """Return how long a plan takes, and whether it is proven free of collisions."""
    words = f"{duration_s:.2f} s of motion"
    if proven is None:
        return words
    return f"{words}, {'proven' if proven else 'NOT proven'} free of collisions"


def _play_once(view: View, poser: Poser, trajectory: Trajectory, overlay: Overlay) -> None:
    began = time.monotonic()
    elapsed_s = 0.0
    while view.alive and elapsed_s < trajectory.duration_s + _PAUSE_S:
        elapsed_s = time.monotonic() - began
        if view.due():
            data = poser.place(trajectory.sample(elapsed_s)[0])
            shown_s = min(elapsed_s, trajectory.duration_s)
            view.update(data, overlay._replace(time_s=shown_s))
        time.sleep(_SLEEP_S)


def play_queries(view: View | None, config: SceneConfig, outcomes: Outcomes) -> None:
    """Play each group's first solved query once; do nothing without a view."""
    if view is None:
        return
    for group, of_group in outcomes.items():
        for outcome in of_group:
            if outcome.result is None:
                continue
            play(
                view,
                Poser(config, outcome.query.scene),
                outcome.result.trajectory,
                f"plan, {group}, query {outcome.query.index}",
                rounds_n=1,
                note=f"planned in {1e3 * outcome.total_s:.0f} ms",
                proven=outcome.result.verification.ok,
            )
            break


def write_paths(path: Path, config: SceneConfig, outcomes: Outcomes) -> None:
    """Draw each group's longest solved trajectory, if possible one that needed a search."""
    pictures: list[tuple[str, Image]] = []
    for group, of_group in outcomes.items():
        solved = [(each, each.result) for each in of_group if each.result is not None]
        if not solved:
            continue
        outcome, result = max(solved, key=lambda pair: _worth_showing(pair[1]))
        title = (
            f"{group}, query {outcome.query.index}: planned in {1e3 * outcome.total_s:.0f} ms, "
            f"lasts {result.trajectory.duration_s:.2f} s"
        )
        from_front, from_above = _renders(config, outcome.query.scene, result.trajectory)
        pictures += [(title, from_front), ("", from_above)]
    if pictures:
        meaning = "Pale: start and midway. Solid: end. Lines: paths of the hands."
        sheet(pictures, 2, path, title=meaning, width_in=5.0)


def _worth_showing(result: PlanResult) -> tuple[bool, float]:
    """Return a sort key: searched paths over straight ones, long ones over short ones."""
    return not result.direct, result.trajectory.duration_s


def write_picture(
    path: Path,
    config: SceneConfig,
    scene: PlanningScene,
    trajectory: Trajectory,
    title: str,
) -> None:
    """Draw a plan from two cameras, solid at the end, pale before."""
    from_front, from_above = _renders(config, scene, trajectory)
    pictures = [
        ("from the front corner", from_front),
        ("from above, the arms' bases on the left", from_above),
    ]
    meaning = f"{title}: pale at the start and midway, solid at the end"
    sheet(pictures, 2, path, title=meaning, width_in=6.5)


def _renders(
    config: SceneConfig,
    scene: PlanningScene,
    trajectory: Trajectory,
) -> tuple[Image, Image]:
    """Return the plan's pictures from the front corner and from above."""
    poser = Poser(config, scene)
    front_corner = free_camera((0.3, 0.0, 0.25), 2.1, 148.0, -28.0)
    above = free_camera((0.35, 0.0, 0.1), 2.2, 90.0, -89.0)
    return _render(poser, trajectory, front_corner), _render(poser, trajectory, above)


def _render(poser: Poser, trajectory: Trajectory, camera: mujoco.MjvCamera) -> Image:
    option = mujoco.MjvOption()
    option.geomgroup[GROUP_COLLISION] = 0
    option.geomgroup[GROUP_MARKER] = 0
    with off_screen(poser.model, *_PICTURE_SIZE, max_geom=20_000) as renderer:
        renderer.update_scene(poser.place(trajectory.q[-1]), camera, scene_option=option)
        for share, opacity in _GHOSTS:
            q, *_ = trajectory.sample(share * trajectory.duration_s)
            _add_ghost(renderer.scene, poser, q, option, opacity)
        for line in tcp_preview(poser.kinematics, trajectory.q).paths:
            _add_line(renderer.scene, line.points, line.rgb)
        return renderer.render()


def _add_ghost(
    scene: Any,
    poser: Poser,
    q: Array,
    option: mujoco.MjvOption,
    opacity: float,
) -> None:
    """Add the moving bodies at q (n,) to a rendered scene."""
    first = scene.ngeom
    moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(poser.model, poser.place(q), option, mujoco.MjvPerturb(), moving, scene)
    for geom in scene.geoms[first : scene.ngeom]:
        geom.rgba[3] *= opacity


def _add_line(scene: Any, points: Array, rgb: Sequence[int]) -> None:
    """Add a polyline (N, 3) [m] to a rendered scene."""
    opaque = np.array([*(channel / 255.0 for channel in rgb), 1.0], dtype=np.float32)
    capsule = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
    for start, end in itertools.pairwise(points):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), opaque)
        mujoco.mjv_connector(geom, capsule, _LINE_RADIUS_M, start, end)
        scene.ngeom += 1
