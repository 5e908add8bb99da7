"""Run the policy that comes with the package on fresh starts, in two ways.

python examples/run_policy.py --trials 2
"""

import argparse

from minidual import load_policy, make_env, run_trials


def by_trials(trials_n: int) -> None:
    """Run judged trials, under the arbiter and the supervisor, as `minidual try` does."""
    trials = run_trials("rod_carry", "act", trials=trials_n, first=100)
    for result in trials:
        print(f"start {result.index}: {result.text}")
    low, high = trials.success_interval
    print(f"{trials.successes_n} of {len(trials)}, 95 % interval {low:.0%} to {high:.0%}")


def by_hand(steps_n: int) -> None:
    """Drive the Gymnasium environment with the policy's actions."""
    policy = load_policy("rod_carry")
    env = make_env("rod_carry", images=tuple(policy.cameras))
    observation, info = env.reset(seed=7)
    policy.reset()
    for _ in range(steps_n):
        action = policy.act(observation["images"], observation["state"])
        observation, _, terminated, truncated, info = env.step(action.astype("float32"))
        if terminated or truncated:
            break
    print(f"environment: success {info['success']} at {info['time_s']:.2f} s")
    print(f"the policy answers at {policy.inference_hz:.0f} Hz")
    env.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2)
    parser.add_argument("--steps", type=int, default=600)
    arguments = parser.parse_args()
    by_trials(arguments.trials)
    by_hand(arguments.steps)
