"""Show planned paths in a live view: the line of each hand, and the arms going along it in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from minidual.gate.stage import StageContext

if TYPE_CHECKING:
    from minidual.config.scene import SceneConfig
    from minidual.robot.trajectory import Trajectory
    from minidual.show.view.protocol import View
    from minidual.trials.planning.evaluate import Outcome


def show_trajectory(view: View, scene: SceneConfig, trajectory: Trajectory, title: str, note: str = "") -> None:
    """Play one trajectory, with the ways of the hands as lines and its end half transparent."""
    from dataclasses import replace

    from minidual.plant.world import World
    from minidual.robot.kinematics import Kinematics
    from minidual.show.narrate import tcp_preview
    from minidual.show.watch_world import Narration, play, visual_model

    world = World(scene, model=visual_model(scene))
    end = world.data.qpos.copy()
    end[world.joints.qpos] = trajectory.q[-1]
    preview = replace(tcp_preview(Kinematics(), trajectory.q), ghosts=(end,))
    words = Narration(title, "moveit", trajectory.group, "played, not simulated", note, preview)
    play(view, scene, trajectory.times, trajectory.q, words)


def show_plans(context: StageContext, outcomes: Mapping[str, Sequence[Outcome]]) -> None:
    """Play the first solved query of each group, if anybody watches."""
    if context.view is None:
        return
    for group, done in outcomes.items():
        first = next((o for o in done if o.result is not None), None)
        if first is not None and first.result is not None:
            note = f"planned in {1e3 * first.total_s:.0f} ms"
            title = f"plan, {group}, query {first.query.index}"
            show_trajectory(context.view, context.config.scene, first.result.trajectory, title, note)
