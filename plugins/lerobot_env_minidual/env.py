"""The tasks of minidual for EnvHub: the file that `make_env` of LeRobot takes from a repository.

It needs the distributions `minidual` and `lerobot_env_minidual`. Without a configuration it makes
`rod_carry`.
"""

from gymnasium.vector import VectorEnv
from lerobot_env_minidual import MinidualEnv


def make_env(
    n_envs: int = 1,
    use_async_envs: bool = False,
    cfg: MinidualEnv | None = None,
) -> dict[str, dict[int, VectorEnv]]:
    """Return {task: {0: vector environment}}."""
    config = cfg if isinstance(cfg, MinidualEnv) else MinidualEnv()
    return config.create_envs(n_envs, use_async_envs)
