"""Recorded episodes: record, find, open, measure."""

from collections.abc import Sequence
from pathlib import Path

from minidual.api.settings import Settings, configured
from minidual.config.scene import RobotConfig
from minidual.demos import recording
from minidual.demos.episode import Episode, episode_paths, read_episode
from minidual.demos.job import Job
from minidual.demos.quality import EpisodeQuality, episode_quality
from minidual.durable import expanded
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import rooms

_EPISODES_MAX = 10_000


def open_episode(path: str | Path, *, cameras: Sequence[str] | None = None) -> Episode:
    """Read a recorded episode (docs/data.md).

    `timestamps` (T,) [s], `qpos` and `action` (T, n) [rad], `gripper` and `action_gripper` (T, 2),
    `images` {camera: (T, H, W, 3)} uint8; `meta` has the task, the rate `fps` and `success`.

    Args:
        path: An HDF5 file.
        cameras: Whose pictures to read; None reads all, () none.

    Raises:
        DataError: Missing, damaged, or of another schema.
    """
    return read_episode(expanded(str(path)), cameras=cameras)


def list_episodes(folder: str | Path) -> list[Path]:
    """Return the files of a folder's episodes in order, such as of teleop-record/episodes."""
    return episode_paths(expanded(str(folder)))


def measure_episode(episode: Episode, *, arm: str = "panda") -> EpisodeQuality:
    """Return the measurements of an episode.

    They are ticks, duration_s, rms_jerk_rad_s3, path_length_m (mean of both hands),
    path_efficiency (0 to 1) and cells_n (5 cm cubes that the hands visit).

    Args:
        episode: Of `open_episode`.
        arm: Arm model that was recorded: "panda", "xarm7" or "ur5".

    Raises:
        DataError: Shorter than 0.5 s, or of other arms.
    """
    return episode_quality(episode, Kinematics(robot_from(RobotConfig(arm=arm))))


def record_episodes(
    folder: str | Path,
    *,
    task: str = "rod_carry",
    episodes: int = 1,
    settings: Settings | None = None,
    workers: int = 1,
) -> list[Path]:
    """Record demonstrations by the scripted operator; return their files.

    A folder that has some of them is completed. For a dataset to train on, with checks and a
    verdict, use `minidual teleop-record`.

    Args:
        folder: Where `episodes/episode_000000.hdf5` is written, and so on.
        task: One of `list_tasks()`.
        episodes: Number of successful demonstrations.
        settings: {dotted path: value} of the configuration, such as {"teleop.cameras": ["high"]}.
        workers: Processes; the episodes do not depend on it.

    Raises:
        UsageError: An unknown name or a wrong setting; too many attempts fail.
    """
    if not 1 <= episodes <= _EPISODES_MAX:
        raise UsageError(f"episodes is {episodes}; 1 <= value <= {_EPISODES_MAX}")
    config = make_task(configured(task, settings)).config
    job = Job(
        folder=expanded(str(folder)),
        task=make_task(config),
        teleop=config.teleop.model_copy(update={"episodes_n": episodes}),
        arbiter=config.arbiter,
        seed=config.seed,
        supervisor=config.supervisor,
        rooms=rooms(config.teleop.conditions),
    )
    recorded = recording.record(job, workers=workers)
    files = [attempt.path for attempt in recorded.kept if attempt.path is not None]
    if len(files) < episodes:
        reasons = ", ".join(sorted({a.reason for a in recorded.attempts if a.reason}))
        raise UsageError(
            f"{len(files)} of {episodes} episodes in {len(recorded.attempts)} attempts: {reasons}",
        )
    return files
