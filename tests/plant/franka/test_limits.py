"""What a controller refuses: each error of the vendor is provoked, and motions within limits pass."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.control.reflexes import REFLEXES
from minidual.plant.franka.cartesian_limits import (
    CartesianMotion,
    is_transformation,
    rotation,
    rotation_vector,
)
from minidual.plant.franka.errors import ERRORS, ERRORS_BY_NAME, names_of
from minidual.plant.franka.limits import (
    DT_S,
    LOST_PACKETS_MAX,
    JointMotion,
    MeasuredState,
    PacketWatch,
    Thresholds,
    TorqueCommands,
    limits_of,
    measured_errors,
)
from minidual.robot.models import PANDA, UR5

LIMITS = limits_of(PANDA)
HOME = np.array(PANDA.home)
ONE = np.eye(7)[1]


def jerk_limited(distance: float, duration_s: float) -> np.ndarray:
    """A smooth path (T,) from rest to rest with continuous jerk."""
    s = np.linspace(0.0, 1.0, round(duration_s / DT_S) + 1)[1:]
    return distance * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)


def first_errors(motion: JointMotion, targets: np.ndarray) -> list[str]:
    for target in targets:
        errors = motion.target(target)
        if errors:
            return errors
    return []


class TestJointTargets:
    def test_a_smooth_motion_passes(self) -> None:
        path = HOME + jerk_limited(0.3, 1.0)[:, None] * ONE
        assert first_errors(JointMotion(LIMITS, HOME), path) == []

    def test_a_start_far_from_the_arm(self) -> None:
        errors = JointMotion(LIMITS, HOME).target(HOME + 0.05)
        assert errors == ["joint_position_motion_generator_start_pose_invalid"]

    def test_a_jump_of_the_target(self) -> None:
        errors = JointMotion(LIMITS, HOME).target(HOME + 0.004 * ONE)
        assert "joint_motion_generator_velocity_limits_violation" in errors
        assert "joint_motion_generator_velocity_discontinuity" in errors
        assert "joint_motion_generator_acceleration_discontinuity" in errors

    def test_too_much_acceleration_alone(self) -> None:
        a = np.minimum(3.5 * np.arange(1, 5), 8.0)
        v = np.cumsum(a) * DT_S
        q = HOME + np.cumsum(v)[:, None] * DT_S * ONE
        assert first_errors(JointMotion(LIMITS, HOME), q) == [
            "joint_motion_generator_velocity_discontinuity"
        ]

    def test_too_much_jerk_alone(self) -> None:
        q = HOME + 6.0 * DT_S**2 * ONE  # 6 rad/s^2 at once: below 7.5, the jerk is 6000
        assert JointMotion(LIMITS, HOME).target(q) == [
            "joint_motion_generator_acceleration_discontinuity"
        ]

    def test_too_fast_a_motion(self) -> None:
        path = HOME + jerk_limited(1.5, 1.2)[:, None] * np.eye(7)[0]
        assert first_errors(JointMotion(LIMITS, HOME), path) == [
            "joint_motion_generator_velocity_limits_violation"
        ]

    def test_the_speed_limit_falls_towards_a_position_limit(self) -> None:
        near = HOME.copy()
        near[1] = LIMITS.q_upper[1] - 0.02
        assert LIMITS.v_upper(near)[1] < 0.15 < LIMITS.v_upper(HOME)[1]
        assert LIMITS.v_lower(near)[1] == -LIMITS.v_max[1]

    def test_a_target_past_a_position_limit(self) -> None:
        at_limit = HOME.copy()
        at_limit[3] = LIMITS.q_upper[3]
        errors = JointMotion(LIMITS, at_limit).target(at_limit + 1e-9 * np.eye(7)[3])
        assert "joint_motion_generator_position_limits_violation" in errors

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_targets_that_are_not_finite(self, value: float) -> None:
        errors = JointMotion(LIMITS, HOME).target(np.where(ONE == 1.0, value, HOME))
        assert errors == ["joint_motion_generator_position_limits_violation"]
        errors = JointMotion(LIMITS, HOME).velocity(np.where(ONE == 1.0, value, 0.0))
        assert errors == ["joint_motion_generator_velocity_limits_violation"]

    def test_velocities_are_checked_like_targets(self) -> None:
        motion = JointMotion(LIMITS, HOME)
        assert motion.velocity(0.003 * ONE) == []
        assert "joint_motion_generator_velocity_discontinuity" in motion.velocity(0.1 * ONE)

    def test_a_lost_command_is_bridged_at_constant_acceleration(self) -> None:
        path = HOME + jerk_limited(0.3, 1.0)[:, None] * ONE
        motion = JointMotion(LIMITS, HOME)
        assert first_errors(motion, path[:200]) == []
        motion.extrapolate()
        assert abs(motion.q[1] - path[200][1]) < 1e-6
        assert first_errors(motion, path[201:]) == []

    def test_what_follows_from_poses_has_names_of_its_own(self) -> None:
        motion = JointMotion(LIMITS, HOME, "cartesian_motion_generator")
        errors = motion.target(HOME + 0.03 * ONE)
        assert errors == [
            "cartesian_motion_generator_joint_velocity_limits_violation",
            "cartesian_motion_generator_joint_velocity_discontinuity",
            "cartesian_motion_generator_joint_acceleration_discontinuity",
        ]
        at_limit = HOME.copy()
        at_limit[3] = LIMITS.q_upper[3]
        motion = JointMotion(LIMITS, at_limit, "cartesian_motion_generator")
        assert "cartesian_motion_generator_joint_position_limits_violation" in motion.target(
            at_limit + 1e-9 * np.eye(7)[3]
        )


class TestPoses:
    def moved(self, shift_m: float = 0.0, turn_rad: float = 0.0) -> np.ndarray:
        pose = np.eye(4)
        pose[0, 3] = shift_m
        pose[:3, :3] = rotation(np.array([0.0, 0.0, turn_rad]))
        return pose

    def test_a_smooth_motion_passes(self) -> None:
        motion = CartesianMotion(LIMITS, np.eye(4))
        for shift in jerk_limited(0.2, 1.0):
            assert motion.target(self.moved(shift, 2.0 * shift)) == []

    def test_a_start_far_from_the_hand(self) -> None:
        for pose in (self.moved(shift_m=0.05), self.moved(turn_rad=0.1)):
            assert CartesianMotion(LIMITS, np.eye(4)).target(pose) == [
                "cartesian_position_motion_generator_start_pose_invalid"
            ]

    def test_a_matrix_that_is_no_pose(self) -> None:
        for wrong in (2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan)):
            assert not is_transformation(wrong)
            assert CartesianMotion(LIMITS, np.eye(4)).target(wrong) == [
                "cartesian_position_motion_generator_invalid_frame"
            ]

    def test_jumps_have_three_names(self) -> None:
        errors = CartesianMotion(LIMITS, np.eye(4)).target(self.moved(shift_m=0.005))
        assert errors == [
            "cartesian_motion_generator_velocity_limits_violation",
            "cartesian_motion_generator_velocity_discontinuity",
            "cartesian_motion_generator_acceleration_discontinuity",
        ]

    @pytest.mark.parametrize("twist", [np.eye(6)[0] * 1.8, np.eye(6)[4] * 2.6])
    def test_too_fast(self, twist: np.ndarray) -> None:
        motion = CartesianMotion(LIMITS, np.eye(4))
        motion.twist = 0.999 * twist
        errors = motion.velocity(twist)
        assert "cartesian_motion_generator_velocity_limits_violation" in errors

    def test_too_much_acceleration_and_too_much_jerk_alone(self) -> None:
        motion = CartesianMotion(LIMITS, np.eye(4))
        errors: list[str] = []
        acceleration = np.minimum(6.0 * np.arange(1, 5), 14.0)
        for v in np.cumsum(acceleration) * DT_S:
            errors = motion.velocity(np.eye(6)[0] * v)
            if errors:
                break
        assert errors == ["cartesian_motion_generator_velocity_discontinuity"]
        errors = CartesianMotion(LIMITS, np.eye(4)).velocity(np.eye(6)[0] * 9.0 * DT_S)
        assert errors == ["cartesian_motion_generator_acceleration_discontinuity"]

    def test_twists_that_are_not_finite(self) -> None:
        errors = CartesianMotion(LIMITS, np.eye(4)).velocity(np.full(6, np.nan))
        assert errors == ["cartesian_motion_generator_velocity_limits_violation"]

    def test_the_elbow(self) -> None:
        prefix = "cartesian_motion_generator"
        fresh = CartesianMotion(LIMITS, np.eye(4), 0.1)
        assert fresh.elbow(0.1, -1.0, -1.0) == []
        assert fresh.elbow(0.11, -1.0, -1.0) == [f"{prefix}_elbow_limit_violation"]
        assert fresh.elbow(0.1, 1.0, -1.0) == [f"{prefix}_elbow_sign_inconsistent"]
        fresh = CartesianMotion(LIMITS, np.eye(4), 0.1)
        assert fresh.elbow(0.3, -1.0, -1.0) == [f"{prefix}_start_elbow_invalid"]

    def test_a_rotation_and_its_vector_are_inverse(self) -> None:
        vector = np.array([0.02, -0.3, 0.5])
        assert np.allclose(rotation_vector(rotation(vector)), vector, atol=1e-12)
        assert np.allclose(rotation_vector(np.eye(3)), 0.0)


class TestTorques:
    def test_torques_may_change_at_the_drives_rate(self) -> None:
        commands = TorqueCommands(LIMITS)
        assert commands.command(0.99 * np.ones(7), np.zeros(7), np.zeros(7)) == []
        errors = commands.command(3.0 * np.ones(7), np.zeros(7), np.zeros(7))
        assert errors == ["controller_torque_discontinuity"]

    def test_torques_that_are_not_finite(self) -> None:
        errors = TorqueCommands(LIMITS).command(np.full(7, np.nan), np.zeros(7), np.zeros(7))
        assert errors == ["controller_torque_discontinuity"]

    def test_too_much_power(self) -> None:
        commands = TorqueCommands(LIMITS)
        errors = commands.command(0.5 * np.ones(7), 80.0 * np.ones(7), 2.0 * np.ones(7))
        assert errors == ["power_limit_violation"]


class TestMeasurements:
    STILL = MeasuredState(HOME, np.zeros(7), np.zeros(7), 0.0, np.array([0.4, 0.0, 0.5]))

    def test_an_arm_at_rest_has_no_error(self) -> None:
        assert measured_errors(self.STILL, LIMITS, ((0.0, 1.0),) * 3) == []

    @pytest.mark.parametrize(
        ("change", "error"),
        [
            ({"q": HOME + 3.0}, "joint_position_limits_violation"),
            ({"v": 3.0 * np.ones(7)}, "joint_velocity_violation"),
            ({"speed_m_per_s": 2.0}, "cartesian_velocity_violation"),
            ({"tau": 120.0 * np.ones(7)}, "tau_j_range_violation"),
            ({"position_m": np.array([0.4, 0.0, -0.1])}, "cartesian_position_limits_violation"),
        ],
    )
    def test_each_violation_has_its_name(self, change: dict, error: str) -> None:
        state = MeasuredState(**{**self.STILL.__dict__, **change})
        assert measured_errors(state, LIMITS, ((0.0, 1.0), (-1.0, 1.0), (0.0, 1.0))) == [error]

    def test_collision_thresholds(self) -> None:
        thresholds = Thresholds.default()
        assert thresholds.collisions(19.0 * np.ones(7), 19.0 * np.ones(6)) == []
        assert thresholds.collisions(21.0 * ONE, np.zeros(6)) == ["joint_reflex"]
        assert thresholds.collisions(np.zeros(7), -21.0 * np.eye(6)[2]) == ["cartesian_reflex"]
        assert thresholds.valid()
        thresholds.upper_torque = np.zeros(7)
        assert not thresholds.valid()

    def test_twenty_lost_packets_in_a_row(self) -> None:
        watch = PacketWatch()
        for _ in range(LOST_PACKETS_MAX - 1):
            assert watch.tick(came=False) == []
        assert watch.tick(came=True) == []
        for _ in range(LOST_PACKETS_MAX - 1):
            assert watch.tick(came=False) == []
        assert watch.tick(came=False) == ["communication_constraints_violation"]
        assert watch.success_rate == pytest.approx(0.61)


def test_an_arm_with_other_joints_has_no_such_interface() -> None:
    with pytest.raises(ValueError, match="'ur5' has 6 joints; the interface is for 7"):
        limits_of(UR5)


def test_every_error_of_the_vendor_is_a_reflex_of_ours() -> None:
    assert len(ERRORS) == len(ERRORS_BY_NAME) == 41
    assert {error.reflex for error in ERRORS} <= set(REFLEXES)
    flags = np.zeros(41, dtype=bool)
    flags[[6, 25]] = True
    assert names_of(flags) == ("joint_reflex", "communication_constraints_violation")
