"""Plan a motion of both arms among obstacles, and print its proof and its times.

python examples/plan_both_arms.py
"""

from pathlib import Path

from minidual import Planner, PlanningError, Sphere, load_scene

SCENE = Path(__file__).with_name("bench-scene.yaml")


def main() -> None:
    """Plan to a named posture, go on to a hand pose, and meet a goal that cannot be reached."""
    lamp = Sphere("lamp", position_m=(0.5, 0.0, 0.75), radius_m=0.1)
    planner = Planner(load_scene(SCENE).with_obstacles(lamp))
    planner.plan("ready")  # the first plan of a process loads compiled code

    start = planner.home
    start[0] = 1.1  # [rad]: the left arm stands to the left of the scene's post
    plan = planner.plan("ready", start=start, seed=1)
    print(
        f"to 'ready': {plan.duration_s:.2f} s of motion, planned in {1e3 * plan.planning_s:.0f} ms"
    )
    print(f"  proven free of collisions: {plan.proven}, clearance {1e3 * plan.clearance_m:.0f} mm")
    for name, seconds in plan.times_s.items():
        print(f"  {name:9} {1e3 * seconds:6.1f} ms")
    for name, share in plan.limits_used.items():
        print(f"  {name:12} {share:4.0%} of the limit")

    # From there the left hand goes 8 cm up; the right hand keeps its pose.
    T_world_tcp = planner.tcp_poses(plan.q_end_rad)["left"]
    T_world_tcp[2, 3] += 0.08
    up = planner.plan({"left": T_world_tcp}, start=plan)
    q, v, _ = up.sample(0.5 * up.duration_s)
    print(
        f"up: {up.duration_s:.2f} s; half-way, the first joint is at {q[0]:.3f} rad, {v[0]:.3f} rad/s"
    )

    T_world_tcp[0, 3] = 2.0
    try:
        planner.plan({"left": T_world_tcp}, start=plan)
    except PlanningError as error:
        print(f"refused: {error.message}")


if __name__ == "__main__":
    main()
