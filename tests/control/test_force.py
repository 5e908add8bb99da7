"""The grasp matrix and the object impedance law, held to mechanics rather than to stored numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from minidual.config.control import CarryConfig, ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control import impedance
from minidual.control.impedance import HeldObject, ObjectImpedance, ObjectState
from minidual.control.kernels import minimum_jerk
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import inverse, pose, rot_x, rot_z
from minidual.skills.object_path import ObjectPath, Waypoint
from minidual.tasks.task import grasp_offsets
from tests.support import force_law_oracle as oracle
from tests.support.carries import impedance_carry
from tests.support.carry_trials import PERFECT_SENSING, rod_judge, rod_trial, sample_trial
from tests.support.panda import HOME, JOINT_DAMPING


def _law(yaw: float = 0.0) -> tuple[ObjectImpedance, np.ndarray, np.ndarray]:
    """A law at the home posture, holding an object midway between the hands, turned by yaw."""
    kinematics = Kinematics()
    left, right = kinematics.tcp_poses(HOME)
    centre = pose(rot_z(yaw), 0.5 * (left[:3, 3] + right[:3, 3]))
    grasps = (inverse(centre) @ left, inverse(centre) @ right)
    axis = grasps[0][:3, 3] - grasps[1][:3, 3]
    held = HeldObject(0.2, np.diag([1.5e-3, 1e-5, 1.5e-3]), grasps, axis / np.linalg.norm(axis))
    law = ObjectImpedance(kinematics, held, ImpedanceConfig())
    law.engage(HOME)
    return law, centre, HOME.copy()


def test_at_rest_at_the_goal_the_hands_carry_weight_and_squeeze_alone() -> None:
    law, centre, q = _law()
    state = ObjectState(centre)
    tau = law.torque(q, np.zeros(14), state, state, wanted_n=40.0, felt_n=40.0)
    kinematics = Kinematics()
    J_left, J_right = kinematics.tcp_jacobians(q)
    external = tau - kinematics.gravity(q)
    f, *_ = np.linalg.lstsq(np.vstack([J_left, J_right]).T, external, rcond=None)
    total = f[:3] + f[6:9]
    assert np.allclose(total, -0.2 * oracle.GRAVITY, atol=1e-6)
    assert np.isclose(f[1], -40.0, atol=1e-6)
    assert np.isclose(f[7], 40.0, atol=1e-6)


def test_force_feedback_is_bounded_and_the_ceiling_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(impedance, "SQUEEZE_MAX_N", 38.0)  # low enough that no motor saturates
    law, centre, q = _law()
    kinematics = Kinematics()
    J = np.vstack(kinematics.tcp_jacobians(q)).T
    state = ObjectState(centre)

    def squeeze(wanted: float, measured: float) -> float:
        tau = law.torque(q, np.zeros(14), state, state, wanted_n=wanted, felt_n=measured)
        f, *_ = np.linalg.lstsq(J, tau - kinematics.gravity(q), rcond=None)
        return float(f[7])

    assert np.isclose(squeeze(30.0, 28.0), 31.0, atol=1e-5)
    assert np.isclose(squeeze(20.0, -200.0), 35.0, atol=1e-5)  # correction limited to 15 N
    assert np.isclose(squeeze(37.0, 0.0), 38.0, atol=1e-5)  # ceiling
    assert np.isclose(squeeze(5.0, 500.0), 0.0, atol=1e-5)  # never a pull


def test_the_spring_pushes_back_towards_the_wanted_pose() -> None:
    law, centre, q = _law()
    shifted = centre.copy()
    shifted[0, 3] += 0.01
    kinematics = Kinematics()
    J = np.vstack(kinematics.tcp_jacobians(q)).T
    tau = law.torque(
        q,
        np.zeros(14),
        ObjectState(centre),
        ObjectState(shifted),
        wanted_n=0.0,
        felt_n=0.0,
    )
    f, *_ = np.linalg.lstsq(J, tau - kinematics.gravity(q), rcond=None)
    assert np.isclose(f[0] + f[6], 500.0 * 0.01, atol=1e-6)


def test_motion_feedforward_asks_for_the_acceleration_of_the_object(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without feedback errors the torques must be those of inverse dynamics for the wanted hand acceleration."""
    monkeypatch.setattr(impedance, "POSTURE_STIFFNESS_PER_S2", 0.0)
    law, centre, q = _law()
    acceleration = np.array([0.5, -0.3, 0.2, 0.0, 0.0, 0.4])
    tau = law.torque(
        q,
        np.zeros(14),
        ObjectState(centre),
        ObjectState(centre, np.zeros(6), acceleration),
        wanted_n=0.0,
        felt_n=0.0,
    )
    kinematics = Kinematics()
    J_left, J_right = kinematics.tcp_jacobians(q)
    M = kinematics.mass_matrix(q)
    J = np.vstack([J_left, J_right])
    # What the object needs from the hands acts back on the arms as an external load.
    inertia = centre[:3, :3] @ law.held.inertia_kg_m2 @ centre[:3, :3].T
    w = np.concatenate([0.2 * (acceleration[:3] - oracle.GRAVITY), inertia @ acceleration[3:]])
    left, right = kinematics.tcp_poses(q)
    p = centre[:3, 3]
    load = J.T @ np.linalg.pinv(oracle.grasp_matrix(left[:3, 3] - p, right[:3, 3] - p)) @ w
    qdd = np.linalg.solve(M, tau - kinematics.bias(q, np.zeros(14)) - load)
    for J_hand, T in ((J_left, left), (J_right, right)):
        r = T[:3, 3] - p
        expected = np.concatenate(
            [acceleration[:3] + np.cross(acceleration[3:], r), acceleration[3:]],
        )
        assert np.allclose(J_hand @ qdd, expected, atol=1e-6)
    assert JOINT_DAMPING > 0.0


def test_energy_does_not_grow_when_a_held_rod_is_let_swing(scene: SceneConfig) -> None:
    """Grasp, squeeze, then hold: kinetic energy dies out and stays out."""
    world = World(scene)
    kinematics = Kinematics()
    config = CarryConfig(sensing=PERFECT_SENSING)
    trial = rod_trial("test", 0, (*scene.task.start_xy_m, 0.0), (*scene.task.start_xy_m, 0.0))
    world.reset(poses=trial.start)
    carry = impedance_carry(world, kinematics, config, trial)
    while carry.phase != "carry":
        carry.step()
    energy = []
    while carry.phase == "carry":  # lift, and lower where it stood
        carry.step()
        v = world.v
        energy.append(0.5 * float(v @ kinematics.mass_matrix(world.q) @ v))
    assert max(energy[:600]) > 1e-2  # it did move
    assert max(energy[-100:]) < 0.02 * max(
        energy,
    )  # what is left is the elbows settling in the null space
    assert np.all(np.diff(energy[-100:]) < 1e-7)  # and it only ever falls
    assert world.truth().internal_force() > 35.0


@given(st.floats(0.001, 0.999))
def test_minimum_jerk_derivatives_match_finite_differences(s: float) -> None:
    h = 1e-6
    blend, rate, curvature = minimum_jerk(s)
    assert np.isclose((minimum_jerk(s + h)[0] - minimum_jerk(s - h)[0]) / (2 * h), rate, atol=1e-5)
    assert np.isclose(
        (minimum_jerk(s + h)[1] - minimum_jerk(s - h)[1]) / (2 * h),
        curvature,
        atol=1e-4,
    )
    assert 0.0 <= blend <= 1.0


def test_object_path_rests_at_its_waypoints_and_its_twist_is_its_derivative() -> None:
    path = ObjectPath(
        Waypoint((0.5, 0.2, 0.01), 0.1, 0.0),
        [Waypoint((0.5, 0.2, 0.1), 0.1, 1.0), Waypoint((0.4, -0.2, 0.1), 0.5, 2.0)],
    )
    assert path.duration_s == 3.0
    for t in (0.0, 1.0, 3.0, 9.0):
        assert np.abs(path.at(t).twist).max() < 1e-12
    h = 1e-5
    for t in (0.3, 1.7, 2.6):
        before = path.at(t - h)
        here = path.at(t)
        after = path.at(t + h)
        velocity = (after.T_world_object[:3, 3] - before.T_world_object[:3, 3]) / (2 * h)
        assert np.allclose(velocity, here.twist[:3], atol=1e-7)
        assert np.allclose((after.twist - before.twist) / (2 * h), here.acceleration, atol=1e-5)


def test_one_real_carry_passes_and_is_the_same_twice(scene: SceneConfig) -> None:
    outcomes = []
    for _ in range(2):
        world = World(scene)
        trial = sample_trial(scene, 5, "test", 0)
        world.reset(poses=trial.start)
        carry = impedance_carry(world, Kinematics(), CarryConfig(), trial)
        judge = rod_judge(scene, trial, demand_internal_force=True)
        while not carry.done and world.time < 14.0:
            carry.step()
            judge.observe(world)
        outcomes.append((judge.outcome(world), world.q.tobytes()))
    first = outcomes[0][0]
    assert first.success, first.reason
    assert first.number("internal_force_min_n") > 35.0
    assert outcomes[0] == outcomes[1]


def test_grasp_offsets_point_down_and_lie_symmetric(scene: SceneConfig) -> None:
    left, right = grasp_offsets(scene)
    assert np.allclose(left[:3, 2], [0, 0, -1])
    assert np.isclose(left[1, 3], scene.object.grasp_offset_m)
    assert np.isclose(right[1, 3], -scene.object.grasp_offset_m)
    assert np.allclose(left[:3, :3], rot_z(np.pi / 2) @ rot_x(np.pi))
