"""Tasks as Gymnasium environments."""

from collections.abc import Sequence

from minidual.api.settings import Settings, configured
from minidual.environments.task_env import TaskEnv
from minidual.errors import UsageError


def make_env(
    task: str = "rod_carry",
    *,
    images: Sequence[str] = (),
    object_pose: bool = False,
    render_mode: str | None = None,
    settings: Settings | None = None,
) -> TaskEnv:
    """Return a task as a Gymnasium environment at 50 Hz (docs/gymnasium.md).

    Observation: `state` (n + 2,), joints of the left and right arm [rad], then openings of both
    hands (0 to 1). Action: joint targets and openings, in the same order. Reward: progress of hands
    and object [m], plus 1 on success.

    Args:
        task: One of `list_tasks()`.
        images: Cameras to observe, out of "high", "left" and "right".
        object_pose: Whether to observe the true pose of the object and its goal.
        render_mode: "rgb_array" to call `render()`, or None.
        settings: {dotted path: value} of the scene, such as {"scene.task.time_limit_s": 10.0}.

    Raises:
        UsageError: Unknown task, camera or render mode, or a setting outside of `scene`.
    """
    outside = [path for path in settings or {} if not path.startswith("scene.")]
    if outside:
        raise UsageError(
            f"an environment has no setting '{outside[0]}'; it takes those that begin with 'scene.'",
        )
    scene = configured(task, settings).scene if settings else None
    return TaskEnv(
        scene,
        task=task,
        images=images,
        object_pose=object_pose,
        render_mode=render_mode,
    )
