"""The fast object impedance law against the same law written out plainly, and against mechanics."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from minidual.config.control import ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control import impedance_kernels
from minidual.control.gripper import pinch_force
from minidual.control.impedance import (
    HeldObject,
    ObjectImpedance,
    ObjectState,
    SingularPostureError,
)
from minidual.errors import DataError, UsageError
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import inverse, pose, rot_z
from minidual.robot.vectors import cross, inner, minus, plus, times
from scripts.bench.scenes import BenchScene, held_scene
from tests.support import force_law_oracle as oracle
from tests.support.arm_scripts import solve_hands
from tests.support.panda import DOF, HOME, TAU_MAX

triples = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(np.array)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return exp of a rotation vector."""
    quat = np.empty(4)
    matrix = np.empty(9)
    angle = float(np.linalg.norm(vector))
    mujoco.mju_axisAngle2Quat(quat, vector / angle if angle > 0.0 else np.array([1.0, 0, 0]), angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


@dataclasses.dataclass
class Case:
    """A random situation of the law."""

    held: HeldObject
    q_engaged: np.ndarray
    q: np.ndarray
    v: np.ndarray
    measured: ObjectState
    desired: ObjectState
    wanted_n: float
    felt_n: float


def draw(rng: np.random.Generator, kinematics: Kinematics, *, turning: bool = True) -> Case:
    q = HOME + 0.15 * rng.normal(size=DOF)
    left, right = kinematics.tcp_poses(q)
    centre = 0.5 * (left[:3, 3] + right[:3, 3]) + 0.02 * rng.normal(size=3)
    T = pose(rotation(0.3 * rng.normal(size=3)), centre)
    grasps = (inverse(T) @ left, inverse(T) @ right)
    axis = grasps[0][:3, 3] - grasps[1][:3, 3]
    root = rng.normal(size=(3, 3))
    held = HeldObject(
        rng.uniform(0.1, 1.5),
        1e-3 * root @ root.T,
        grasps,
        axis / np.linalg.norm(axis),
    )
    twist = 0.3 * rng.normal(size=6)
    acceleration = 0.5 * rng.normal(size=6)
    if not turning:
        twist[3:] = acceleration[3:] = 0.0
    T_d = pose(rotation(0.1 * rng.normal(size=3)) @ T[:3, :3], centre + 0.02 * rng.normal(size=3))
    return Case(
        held,
        q,
        q + 0.02 * rng.normal(size=DOF),
        0.3 * rng.normal(size=DOF),
        ObjectState(T, 0.2 * rng.normal(size=6)),
        ObjectState(T_d, twist, acceleration),
        20.0,
        float(rng.uniform(-20.0, 60.0)),
    )


class TestOracle:
    @pytest.mark.parametrize("turning", [True, False])
    def test_the_fast_law_is_the_law(self, kinematics: Kinematics, turning: bool) -> None:
        rng = np.random.default_rng(7)
        unclipped = 0
        gains = ImpedanceConfig(
            stiffness_n_per_m=450.0,
            stiffness_nm_per_rad=18.0,
            damping_ratio=0.8,
        )
        for _ in range(40):
            case = draw(rng, kinematics, turning=turning)
            law = ObjectImpedance(kinematics, case.held, gains)
            law.engage(case.q_engaged)
            for _ in range(2):  # buffers are reused: the second call must not see the first
                tau = law.torque(
                    case.q,
                    case.v,
                    case.measured,
                    case.desired,
                    wanted_n=case.wanted_n,
                    felt_n=case.felt_n,
                )
            plain = oracle.torque(
                kinematics,
                case.held,
                gains,
                case.q_engaged,
                case.q,
                case.v,
                case.measured,
                case.desired,
                case.wanted_n,
                case.felt_n,
            )
            unclipped += int((np.abs(plain) < TAU_MAX).all())
            assert np.abs(tau - plain).max() < 5e-9  # the oracle's drift is a finite difference
        assert unclipped > 25

    def test_a_squeeze_in_world_axes_keeps_its_first_direction(
        self,
        kinematics: Kinematics,
    ) -> None:
        """It equals a law whose axis, in object axes, turns against the object."""
        case = draw(np.random.default_rng(5), kinematics)
        elsewhere = case.q_engaged + 0.2
        left, right = (T[:3, 3] for T in kinematics.tcp_poses(elsewhere))
        first = (left - right) / np.linalg.norm(left - right)
        turned = dataclasses.replace(case.held, axis=case.measured.T_world_object[:3, :3].T @ first)

        def torque(held: HeldObject, gains: ImpedanceConfig) -> np.ndarray:
            law = ObjectImpedance(kinematics, held, gains)
            law.engage(elsewhere)
            return law.torque(
                case.q,
                case.v,
                case.measured,
                case.desired,
                wanted_n=case.wanted_n,
                felt_n=case.felt_n,
            )

        world = torque(case.held, ImpedanceConfig(squeeze_axes="world"))
        assert world == pytest.approx(torque(turned, ImpedanceConfig()), abs=1e-12)
        assert np.abs(world - torque(case.held, ImpedanceConfig())).max() > 0.1

    def test_the_oracle_notices_every_term(self, kinematics: Kinematics) -> None:
        """Change one thing the law must heed: the torques must answer."""
        case = draw(np.random.default_rng(3), kinematics)
        case.felt_n = 15.0

        def torque(case: Case, gains: ImpedanceConfig | None = None) -> np.ndarray:
            law = ObjectImpedance(kinematics, case.held, gains or ImpedanceConfig())
            law.engage(case.q_engaged)
            return law.torque(
                case.q,
                case.v,
                case.measured,
                case.desired,
                wanted_n=case.wanted_n,
                felt_n=case.felt_n,
            )

        before = torque(case)
        assert (np.abs(before) < TAU_MAX).all()
        heavier = dataclasses.replace(case.held, mass_kg=case.held.mass_kg + 0.1)
        rounder = dataclasses.replace(case.held, inertia_kg_m2=2.0 * case.held.inertia_kg_m2)
        still = case.desired._replace(acceleration=np.zeros(6))
        for changed in (
            torque(dataclasses.replace(case, held=heavier)),
            torque(dataclasses.replace(case, held=rounder)),
            torque(dataclasses.replace(case, desired=still)),
            torque(dataclasses.replace(case, felt_n=18.0)),
            torque(dataclasses.replace(case, q_engaged=case.q_engaged + 0.05)),
            torque(case, ImpedanceConfig(stiffness_nm_per_rad=21.0)),
            torque(case, ImpedanceConfig(damping_ratio=0.5)),
        ):
            assert np.abs(changed - before).max() > 1e-3

    def test_a_measured_force_that_is_no_number_is_named(self, kinematics: Kinematics) -> None:
        held = draw(np.random.default_rng(1), kinematics).held
        law = ObjectImpedance(kinematics, held, ImpedanceConfig())
        law.engage(HOME)
        T_left, T_right = kinematics.tcp_poses(HOME)
        state = ObjectState(pose(np.eye(3), 0.5 * (T_left[:3, 3] + T_right[:3, 3])))
        rest = np.zeros(DOF)
        tau = law.torque(HOME, rest, state, state, wanted_n=40.0, felt_n=40.0)
        assert np.isfinite(tau).all()
        with pytest.raises(DataError, match="internal force is not finite"):
            law.torque(HOME, rest, state, state, wanted_n=40.0, felt_n=np.nan)

    def test_a_lost_direction_is_named(self, kinematics: Kinematics) -> None:
        law = ObjectImpedance(
            kinematics,
            draw(np.random.default_rng(1), kinematics).held,
            ImpedanceConfig(),
        )
        law.engage(HOME)
        law._hands.update = lambda *_: law._hands.J.fill(0.0)  # type: ignore[method-assign]
        state = ObjectState(np.eye(4))
        with pytest.raises(SingularPostureError, match="singular") as caught:
            law.torque(HOME, np.zeros(DOF), state, state, wanted_n=0.0, felt_n=0.0)
        assert caught.value.remedy

    @pytest.mark.parametrize("hand", [0, 1])
    def test_a_direction_that_is_lost_already_when_it_takes_over_is_named_too(
        self,
        kinematics: Kinematics,
        monkeypatch: pytest.MonkeyPatch,
        hand: int,
    ) -> None:
        law = ObjectImpedance(
            kinematics,
            draw(np.random.default_rng(1), kinematics).held,
            ImpedanceConfig(),
        )
        jacobians = [J.copy() for J in kinematics.tcp_jacobians(HOME)]
        jacobians[hand][2] = 0.0  # no joint lifts this hand
        monkeypatch.setattr(kinematics, "tcp_jacobians", lambda q: tuple(jacobians))
        with pytest.raises(SingularPostureError, match=("left hand", "right hand")[hand]) as caught:
            law.engage(HOME)
        assert caught.value.remedy


class TestGrasp:
    @given(triples, triples, triples, triples, triples)
    @settings(max_examples=50)
    def test_the_closed_form_is_the_distribution(
        self,
        r_l: np.ndarray,
        r_r: np.ndarray,
        force: np.ndarray,
        moment: np.ndarray,
        squeeze: np.ndarray,
    ) -> None:
        w = np.concatenate([force, moment])
        f_int = np.concatenate([-squeeze, np.zeros(3), squeeze, np.zeros(3)])
        G = oracle.grasp_matrix(r_l, r_r)
        plain = np.linalg.pinv(G) @ w + oracle.split(G, f_int)[1]
        f = np.ravel(
            impedance_kernels.hand_wrenches(
                tuple(force),
                tuple(moment),
                tuple(r_l),
                tuple(r_r),
                tuple(squeeze),
            ),
        )
        assert np.allclose(f, plain, atol=1e-9)
        assert np.allclose(G @ f, w, atol=1e-9)

    @given(triples, triples, triples)
    @settings(max_examples=50)
    def test_a_squeeze_does_no_work_on_any_rigid_motion(
        self,
        r_l: np.ndarray,
        r_r: np.ndarray,
        squeeze: np.ndarray,
    ) -> None:
        f = np.ravel(
            impedance_kernels.hand_wrenches(
                (0.0,) * 3, (0.0,) * 3, tuple(r_l), tuple(r_r), tuple(squeeze)
            ),
        )
        assert np.abs(oracle.grasp_matrix(r_l, r_r) @ f).max() < 1e-9

    @pytest.mark.parametrize("yaw", [np.pi / 2, -2.0])
    def test_a_squeeze_that_does_not_turn_with_the_rod_twists_it(self, yaw: float) -> None:
        axis = rot_z(yaw) @ np.array([0.0, 1.0, 0.0])
        G = oracle.grasp_matrix(0.12 * axis, -0.12 * axis)
        assert np.abs(G @ oracle.squeeze_reference(axis, 40.0)).max() < 1e-9
        assert np.abs(G @ oracle.squeeze_reference(np.array([0.0, 1.0, 0.0]), 40.0)).max() > 1.0

    @pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
    def test_a_rod_turned_by_90_degrees_keeps_its_squeeze_along_itself(
        self,
        kinematics: Kinematics,
        yaw: float,
    ) -> None:
        """Arms really reach round the turned rod; what their torques put on it is measured by statics."""
        T = pose(rot_z(yaw), (0.45, 0.0, 0.35))
        down = rot_z(np.pi / 2) @ np.diag([1.0, -1.0, -1.0])
        grasps = (pose(down, (0.0, 0.12, 0.0)), pose(down, (0.0, -0.12, 0.0)))
        q = solve_hands(kinematics, (T @ grasps[0], T @ grasps[1]), HOME)
        held = HeldObject(0.2, np.diag([1.5e-3, 1e-5, 1.5e-3]), grasps, np.array([0.0, 1.0, 0.0]))
        law = ObjectImpedance(kinematics, held, ImpedanceConfig())
        law.engage(q)
        state = ObjectState(T)
        tau = law.torque(q, np.zeros(DOF), state, state, wanted_n=30.0, felt_n=30.0)
        J = np.vstack(kinematics.tcp_jacobians(q))
        f = np.linalg.lstsq(J.T, tau - kinematics.gravity(q), rcond=None)[0]
        axis = T[:3, 1]
        carried = np.array([0.0, 0.0, 0.2 * 9.81 / 2.0])
        assert f[0:3] == pytest.approx(-30.0 * axis + carried, abs=1e-6)
        assert f[6:9] == pytest.approx(30.0 * axis + carried, abs=1e-6)
        assert f[3:6] == pytest.approx(np.zeros(3), abs=1e-6)
        internal = oracle.squeeze_reference(axis, 30.0)
        rigid = oracle.grasp_matrix(0.12 * axis, -0.12 * axis).T @ np.array(
            [0.3, -0.2, 0.1, 0.5, 1.0, -2.0],
        )
        assert internal @ rigid == pytest.approx(0.0, abs=1e-9)  # no work on any motion of the rod


@pytest.fixture(scope="module")
def held() -> BenchScene:
    return held_scene(SceneConfig(), ImpedanceConfig())


class TestHeld:
    @staticmethod
    def _run(held: BenchScene, desired: ObjectState, steps: int, squeeze_n: float):
        world = held.world
        grippers = held.grippers()
        for _ in range(steps):
            measured, felt = held.sense()
            tau = held.law.torque(
                world.q,
                world.v,
                measured,
                desired,
                wanted_n=squeeze_n,
                felt_n=felt,
            )
            fingers_m = grippers.step(held.gripper, world.fingers, world.grip)
            world.command(tau, fingers_m)
            world.step()
            yield measured, felt

    def test_stored_energy_falls(self, held: BenchScene) -> None:
        """The rod is pulled 2 cm off and let go: kinetic energy of the arms plus what the object's spring stores."""
        held.restore()
        T = held.rest.copy()
        T[:3, 3] += (0.0, 0.015, 0.015)
        stiffness = oracle.stiffness(held.law.gains)
        energy = []
        for measured, _ in self._run(held, ObjectState(T), 1200, 40.0):
            M = held.kinematics.mass_matrix(held.world.q)
            v = held.world.v
            R = measured.T_world_object[:3, :3]
            e = np.concatenate(
                [T[:3, 3] - measured.T_world_object[:3, 3], pin.log3(T[:3, :3] @ R.T)],
            )
            energy.append(0.5 * v @ M @ v + 0.5 * e @ (stiffness * e))
        assert energy[0] > 0.1
        rises = np.maximum(np.diff(energy), 0.0).sum()
        assert rises < 2e-3 * energy[0]  # what the squeeze's own settling puts in
        assert energy[-1] < 0.01 * energy[0]

    @pytest.mark.parametrize("axis", ["x", "y", "z"])
    @pytest.mark.parametrize("stiffness", [20.0, 40.0])
    def test_a_moment_turns_the_held_object_by_what_the_stiffness_says(
        self,
        held: BenchScene,
        axis: str,
        stiffness: float,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        """Apply 0.4 Nm about one axis of the world, slowly: angle = moment / K within 10 %."""
        moment = 0.4
        world = held.world
        k = "xyz".index(axis)
        held.restore()
        gains = ImpedanceConfig(stiffness_nm_per_rad=stiffness)
        law = ObjectImpedance(held.kinematics, held.law.held, gains)
        law.engage(world.q)
        monkeypatch.setattr(held, "law", law)
        load = world.data.body("rod").xfrc_applied[3:]
        for step, _ in enumerate(self._run(held, ObjectState(held.rest), 2000, 40.0)):
            load[k] = moment * min(1.0, max(0.0, step - 200.0) / 300.0)
            if step == 200:
                R_before = world.object_pose()[:3, :3]
        turned = pin.log3(world.object_pose()[:3, :3] @ R_before.T)
        load[:] = 0.0
        held.restore()
        assert moment / turned[k] == pytest.approx(stiffness, rel=0.1)
        assert np.abs(np.delete(turned, k)).max() < 0.05 * turned[k]

    def test_pads_carry_no_more_than_friction_lets_them(self, held: BenchScene) -> None:
        """The limit is real: asked for 75 N at mu 0.5 and 60 N of pinch, the pads hold 60 N and slip at once."""
        limit = 60.0
        assert pinch_force(limit, 0.5, safety=1.0) == pytest.approx(60.0)
        held.restore()
        felt = [felt for _, felt in self._run(held, ObjectState(held.rest), 400, 75.0)]
        slipped = int(np.argmax(np.array(felt) < 20.0))
        assert 0 < slipped < 50
        assert 0.95 * limit < np.max(felt[:slipped]) < 1.05 * limit
        held.restore()
        asked = brentq(
            lambda squeeze: pinch_force(squeeze, 0.5, 0.2, safety=1.25) - 60.0,
            0.0,
            80.0,
        )
        felt = [felt for _, felt in self._run(held, ObjectState(held.rest), 400, asked)]
        assert felt[-1] == pytest.approx(asked, abs=0.5)
        held.restore()


class TestPinch:
    def test_a_light_object_needs_half_the_squeeze_over_mu(self) -> None:
        assert pinch_force(40.0, 0.5, safety=1.0) == pytest.approx(40.0)
        assert pinch_force(40.0, 0.5) == pytest.approx(
            60.0,
        )  # what the joint-space modes pinch with
        assert pinch_force(0.0, 0.5, 2.0, safety=1.0) == pytest.approx(2.0 * 9.81 / 2.0)

    def test_weight_asks_for_more(self) -> None:
        assert pinch_force(27.0, 0.7, 1.0) > pinch_force(27.0, 0.7)

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ((-1.0, 0.5, 0.2), "squeeze -1.0 N"),
            ((40.0, 0.0, 0.2), "friction coefficient 0.0"),
            ((40.0, 0.5, -0.2), "mass -0.2 kg"),
            ((math.nan, 0.5, 0.2), "squeeze nan"),
        ],
    )
    def test_nonsense_is_refused_by_name(
        self,
        values: tuple[float, float, float],
        message: str,
    ) -> None:
        with pytest.raises(UsageError, match=message):
            pinch_force(*values)
        with pytest.raises(UsageError, match=r"safety factor 0\.9"):
            pinch_force(40.0, 0.5, safety=0.9)


class TestHands:
    def test_poses_and_jacobian(self, kinematics: Kinematics) -> None:
        rng = np.random.default_rng(4)
        hands = Hands(kinematics)
        for _ in range(10):
            q = HOME + 0.3 * rng.normal(size=DOF)
            jacobians = kinematics.tcp_jacobians(q)
            poses = kinematics.tcp_poses(q)
            hands.update(q)  # `tcp_poses` works in the same memory
            for i, T in enumerate(poses):
                arm = slice(7 * i, 7 * i + 7)
                assert np.allclose(hands.R[i], T[:3, :3], atol=1e-12)
                assert np.allclose(hands.p[i], T[:3, 3], atol=1e-12)
                linear = hands.J[:3, arm]
                angular = hands.J[3:, arm]
                at_hand = np.vstack([linear + np.cross(angular, hands.p[i], axis=0), angular])
                assert np.allclose(at_hand, jacobians[i][:, arm], atol=1e-12)


class TestVectors:
    @given(triples, triples, st.floats(-2, 2))
    def test_they_are_what_numpy_says(self, a: np.ndarray, b: np.ndarray, s: float) -> None:
        x = a.tolist()
        y = b.tolist()
        for mine, numpys in (
            (cross(x, y), np.cross(a, b)),
            (plus(x, y), a + b),
            (minus(x, y), a - b),
            (times(s, x), s * a),
            (inner(x, y), a @ b),
        ):
            assert np.allclose(mine, numpys, atol=1e-12)
