"""Compare two methods, then one method under two settings, on the same starts.

python examples/compare_methods.py --task pot_lift --trials 5
"""

import argparse
import math

from minidual import Trials, compare, list_tasks, run_trials


def show(trials: Trials) -> None:
    """Print the results of one series."""
    low, high = trials.success_interval
    tilt_deg = math.degrees(trials.median("tilt_max_rad"))
    print(
        f"{trials.label}: {trials.successes_n} of {len(trials)} succeed"
        f" (95 % interval {low:.0%} to {high:.0%}), median {trials.median('duration_s'):.2f} s,"
        f" tilt {tilt_deg:.2f} deg",
    )
    for result in trials:
        if not result.success:
            print(f"  start {result.index}: {result.text}")


def main() -> None:
    """Run the trials and print one sentence for each comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="pot_lift", choices=list_tasks())
    parser.add_argument("--trials", type=int, default=5)
    arguments = parser.parse_args()
    task: str = arguments.task
    trials_n: int = arguments.trials

    planned = run_trials(task, "moveit", trials=trials_n)
    compliant = run_trials(task, "impedance", trials=trials_n)
    show(planned)
    show(compliant)
    print(compare(planned, compliant).sentence)

    soft = {"carry.impedance.stiffness_n_per_m": 300.0}
    softer = run_trials(task, "impedance", trials=trials_n, settings=soft, label="soft impedance")
    show(softer)
    print(compare(compliant, softer).sentence)

    planned.write_csv("trials.csv")


if __name__ == "__main__":
    main()
