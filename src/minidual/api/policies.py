"""Learned policies: those that come with the package, and those of a run."""

from pathlib import Path

from minidual.api.settings import configured
from minidual.config.scene import RobotConfig
from minidual.durable import expanded
from minidual.errors import UsageError
from minidual.policies.pilot import load_runtime
from minidual.policies.policy import PolicyRuntime
from minidual.policies.server_address import folder_of, is_address
from minidual.policies.shipped import shipped_policy
from minidual.robot.pair import robot_from
from minidual.tasks.catalogue import TASKS, make_task

_CONFIG = "config.json"


def load_policy(
    policy: str | Path,
    *,
    task: str = "",
    device: str = "cpu",
    arm: str = "panda",
) -> PolicyRuntime:
    """Load a policy: of a task that one comes with the package for, or of a checkpoint folder.

    The policy maps pictures and joints to joint targets at 50 Hz: `reset()` before each trial, then
    `act(images, state)` at each tick. `cameras` is {camera: (height, width)} of what it needs, and
    `inputs` {signal: entries} of what a state holds behind joints and openings.

    Args:
        policy: A task ("rod_carry"), the folder of a checkpoint
            ("runs/standard/train-act/checkpoint", or one of LeRobot's), or the address of a policy
            server ("ws://127.0.0.1:8000").
        task: Of a policy that was trained on several tasks, the one to do.
        device: "cpu" or "cuda".
        arm: Arm model that was recorded: "panda", "xarm7" or "ur5".

    Raises:
        UsageError: No such policy, or one for other arms.
        DataError: The checkpoint is damaged.
    """
    checkpoint = checkpoint_of(policy)
    config = configured(task or "rod_carry", {"deploy.device": device})
    robot = robot_from(RobotConfig(arm=arm))
    instruction = make_task(config).instruction if task else ""
    return load_runtime(checkpoint, config.deploy, robot, instruction=instruction)


def checkpoint_of(policy: str | Path, method: str = "act") -> Path:
    """Return the checkpoint folder of a method's shipped policy for a task, or a folder with one.

    The address of a policy server gives a folder that stands for it.

    Raises:
        UsageError: There is none.
    """
    if isinstance(policy, str) and policy in TASKS:
        shipped = shipped_policy(policy, method)
        if shipped is not None:
            return shipped
    if is_address(str(policy)):
        return folder_of(str(policy))
    folder = expanded(str(policy))
    if (folder / _CONFIG).is_file():
        return folder
    tasks = ", ".join(task for task in TASKS if shipped_policy(task, method)) or "none"
    raise UsageError(
        f"there is no policy '{policy}': it is neither the folder of a checkpoint (with"
        f" {_CONFIG}) nor a task that a policy comes with the package for ({tasks})",
        remedy="train one: minidual run --until train-act; then name runs/RUN/train-act/checkpoint",
    )
