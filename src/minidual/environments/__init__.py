"""Tasks as environments for learning: one world with pictures, or many without (docs/gymnasium.md).

Importing this package registers them with Gymnasium, which imports the part of a name before its
colon: `gymnasium.make("minidual.environments:minidual/PotLift-v0")`.
"""

from gymnasium.envs.registration import register, registry

from minidual.tasks.catalogue import TASKS

for _task in TASKS:
    _id = f"minidual/{_task.title().replace('_', '')}-v0"
    if _id not in registry:
        register(
            id=_id,
            entry_point="minidual.environments.task_env:TaskEnv",
            vector_entry_point="minidual.environments.batched:BatchedEnv",
            kwargs={"task": _task},
        )
