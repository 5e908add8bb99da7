"""Step a task's Gymnasium environment with a random policy.

python examples/random_policy.py --task pot_lift --steps 200
"""

import argparse

import numpy as np
from gymnasium.utils.env_checker import check_env

from minidual import list_tasks, make_env


def main() -> None:
    """Sway around the posture of the start, and print the return of each episode."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="pot_lift", choices=list_tasks())
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--check", action="store_true", help="check the interface, too")
    arguments = parser.parse_args()
    task: str = arguments.task
    steps_n: int = arguments.steps

    env = make_env(task, object_pose=True, settings={"scene.task.time_limit_s": 2.0})
    if arguments.check:
        check_env(env, skip_render_check=True)
    env.action_space.seed(0)
    observation, info = env.reset(seed=0)
    print(f"start of the object {np.round(observation['object'][:3], 3)} m")
    print(f"goal (x [m], y [m], yaw [rad]) {np.round(observation['goal'], 3)}")
    home = observation["state"]
    returned = 0.0
    for _ in range(steps_n):
        action = home + 0.05 * (env.action_space.sample() - home)
        observation, reward, terminated, truncated, info = env.step(action)
        returned += reward
        if terminated or truncated:
            print(f"{info['time_s']:.2f} s: return {returned:.3f}, failures {info['failures']}")
            observation, info = env.reset()
            home = observation["state"]
            returned = 0.0
    print(f"{steps_n} steps of 20 ms, success {info.get('success', False)}")
    env.close()


if __name__ == "__main__":
    main()
