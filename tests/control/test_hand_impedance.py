"""Impedance of one hand: against statics, its bounds, what it is relative to, and switches to it and back."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.hand_impedance import (
    FORCE_MAX_N,
    MOMENT_MAX_NM,
    STIFFNESS_N_PER_M,
    STIFFNESS_NM_PER_RAD,
    HandImpedance,
    InHand,
)
from minidual.control.impedance import SingularPostureError
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array, inverse, pose, rot_x, rot_z
from tests.support.control_plant import ArmsPlant
from tests.support.panda import HOME, TAU_RATE_MAX
from tests.support.stacks import OPEN, hand_over, move, stack_on, trajectory

RIGHT = slice(7, 14)
SOFT = ("left_arm", "right_hand")
STILL = np.zeros(14)
PEG = InHand(
    "peg",
    pose(rot_x(0.3), (0.01, 0.0, 0.02)),
    pose(rot_x(0.25), (0.0, 0.0, 0.02)),
    (0.02, 0.1, 0.0),
)


def law_of(held: InHand, other: InHand | None = None, learning: bool = False) -> HandImpedance:
    law = HandImpedance(Kinematics(), 1, 1e-3 if learning else 0.0)
    law.held = held
    law.other = other
    law.engage(HOME)
    return law


def wrench_of(
    law: HandImpedance,
    q: Array,
    q_ref: Array,
    held: InHand,
    v_ref: Array = STILL,
) -> tuple[Array, Array]:
    """Return force and moment (6,) at the centre of compliance, world axes; and T_world_object."""
    kinematics = Kinematics()
    push = (law.torque(q, STILL, q_ref, v_ref, STILL) - kinematics.gravity(q))[RIGHT]
    J = kinematics.tcp_jacobians(q)[1][:, RIGHT]
    T_tcp = kinematics.tcp_poses(q)[1]
    # The part of the torque that the null space takes does no work on the hand.
    at_tcp = np.linalg.solve(
        J @ np.linalg.solve(inertia(q), J.T),
        J @ np.linalg.solve(inertia(q), push),
    )
    T = T_tcp @ held.T_tcp_object
    centre = T[:3, :3] @ held.centre_m + T[:3, 3]
    moment = at_tcp[3:] - np.cross(centre - T_tcp[:3, 3], at_tcp[:3])
    return np.r_[at_tcp[:3], moment], T


def inertia(q: Array) -> Array:
    return Kinematics().mass_matrix(q)[RIGHT, RIGHT]


def test_the_spring_acts_at_the_centre_of_compliance_along_the_axes_of_the_object() -> None:
    """Within its bounds: force and moment are stiffness times how far the centre is from where it ought to be."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        q = HOME + 0.1 * rng.normal(size=14)
        q_ref = q + 0.0015 * rng.normal(size=14)
        held = PEG._replace(T_tcp_planned=PEG.T_tcp_object)
        law = law_of(held)
        wrench, T = wrench_of(law, q, q_ref, held)
        T_ref = Kinematics().tcp_poses(q_ref)[1] @ held.T_tcp_object
        away = (T_ref - T) @ [*held.centre_m, 1.0]
        expected = np.r_[
            STIFFNESS_N_PER_M * away[:3],
            STIFFNESS_NM_PER_RAD * pin.log3(T_ref[:3, :3] @ T[:3, :3].T),
        ]
        assert np.abs(expected[:3]).max() < FORCE_MAX_N
        np.testing.assert_allclose(wrench, expected, atol=1e-6)


def test_the_damping_pulls_towards_the_motion_of_the_reference_along_the_axes_of_the_object() -> (
    None
):
    held = PEG._replace(T_tcp_planned=PEG.T_tcp_object)
    rng = np.random.default_rng(6)
    h = 1e-6
    law = law_of(held)
    v_ref = 0.02 * rng.normal(size=14)
    wrench, T = wrench_of(law, HOME, HOME, held, v_ref)
    ahead, behind = (
        Kinematics().tcp_poses(HOME + sign * h * v_ref)[1] @ held.T_tcp_object
        for sign in (1.0, -1.0)
    )
    axes = T[:3, :3]
    motion = (
        np.r_[(ahead - behind) @ [*held.centre_m, 1.0]][:3],
        pin.log3(ahead[:3, :3] @ behind[:3, :3].T),
    )
    along = np.concatenate([part / (2 * h) @ axes for part in motion])
    D = law._law["D"][0]
    np.testing.assert_allclose(
        np.concatenate([wrench[:3] @ axes, wrench[3:] @ axes]),
        D @ along,
        rtol=1e-5,
        atol=1e-7,
    )
    assert np.linalg.eigvalsh(D).min() > 0.0


def test_force_and_moment_are_bounded_however_far_the_reference_is() -> None:
    held = PEG._replace(T_tcp_planned=PEG.T_tcp_object)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q_ref = HOME + 0.1 * rng.normal(size=14)
        law = law_of(held, learning=True)
        for _ in range(400):
            law.torque(HOME, STILL, q_ref, STILL, STILL)
        wrench, _ = wrench_of(law, HOME, q_ref, held)
        T_ref = Kinematics().tcp_poses(q_ref)[1] @ held.T_tcp_object
        along = np.r_[wrench[:3] @ T_ref[:3, :3], wrench[3:] @ T_ref[:3, :3]]
        assert np.abs(along[:3]).max() <= FORCE_MAX_N + 1e-6
        assert np.abs(along[3:]).max() <= MOMENT_MAX_NM + 1e-6
        assert np.abs(along[:3]).max() > 0.99 * FORCE_MAX_N


def test_the_reference_moves_with_what_the_other_hand_holds() -> None:
    """The plan's grasps are off, and so is the other arm: the objects come to lie as planned, seen from each other."""
    rng = np.random.default_rng(5)
    other = PEG._replace(name="socket", T_tcp_object=pose(rot_z(0.05), (0.0, 0.004, 0.003)))
    q_ref = HOME + 0.05 * rng.normal(size=14)
    q = HOME.copy()
    law = law_of(PEG, other)
    kinematics = Kinematics()
    left, right = kinematics.tcp_poses(q_ref)
    planned = inverse(left @ other.T_tcp_planned) @ right @ PEG.T_tcp_planned
    T_wanted = kinematics.tcp_poses(q)[0] @ other.T_tcp_object @ planned
    np.testing.assert_allclose(law._wanted(q, q_ref), T_wanted, atol=1e-12)
    law = law_of(PEG)
    np.testing.assert_allclose(law._wanted(q, q_ref), right @ PEG.T_tcp_planned, atol=1e-12)


@pytest.fixture
def plant(scene: SceneConfig) -> ArmsPlant:
    return ArmsPlant(scene)


def test_switches_to_a_hand_and_back_do_not_jump_and_the_plan_is_followed(plant: ArmsPlant) -> None:
    """Between motions, as a task does it; what is noted of the grasp differs from the plan by 10 mm."""
    stack = stack_on(plant, supervisor=Supervisor())
    hand_over(stack, "moveit")
    stack.hands[1].law.held = InHand("peg", pose(np.eye(3), (0.01, 0.0, 0.0)))
    end = HOME + np.r_[np.zeros(7), 0.1 * np.ones(7)]
    for sequence, (names, a, b) in enumerate(
        [(SOFT, HOME, end), (("both_arms",), end, HOME)],
        start=1,
    ):
        steps = [stack.applied]
        stack.switch_controllers(names)
        assert stack.propose("moveit", trajectory(stack, move(a, b, 1.0), sequence)) is None
        while stack.executing:
            stack.step()
            steps.append(stack.applied)
        assert np.abs(np.diff(steps, axis=0)).max() < 0.3 * TAU_RATE_MAX * plant.dt
        for _ in range(300):
            stack.step()
        assert stack.manager.active == names
    np.testing.assert_allclose(plant.q[:7], HOME[:7], atol=2e-3)
    assert stack.refusals == []


def test_the_hand_follows_what_streams_and_gives_way_to_a_push(plant: ArmsPlant) -> None:
    """Held by a stiff arm it would hardly move; both arms return when nobody pushes."""
    stack = stack_on(plant)
    hand_over(stack, "moveit", SOFT)
    kinematics = Kinematics()
    ways = []
    pushed = 4.0 * kinematics.tcp_jacobians(HOME)[1][0]
    command = plant.command
    plant.command = lambda tau, fingers: command(tau + pushed, fingers)
    for _ in range(60):
        stack.step()
    ways.append(kinematics.tcp_poses(plant.q)[1][0, 3] - kinematics.tcp_poses(HOME)[1][0, 3])
    assert 2e-4 < ways[0] < 4.0 / STIFFNESS_N_PER_M
    np.testing.assert_allclose(plant.q[:7], HOME[:7], atol=1e-4)


def test_a_soft_hand_may_press_and_stay_back_although_it_is_open(plant: ArmsPlant) -> None:
    supervisor = Supervisor()
    stack = stack_on(plant, supervisor=supervisor)
    for controllers, mode in ((("both_arms",), "free motion"), (SOFT, "closed hands")):
        hand_over(stack, "moveit", controllers)
        for _ in range(2000):
            if stack.grippers.wide:
                break
            stack.step()
        assert supervisor.expected().mode == mode
        stack.request("hold")
        stack.step()


def test_a_stretched_arm_stops_the_arms_by_name(
    plant: ArmsPlant,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stack: ControlStack = stack_on(plant, supervisor=Supervisor())
    hand_over(stack, "moveit", SOFT)

    law = stack.hands[1].law
    lost = Hands(stack.kinematics)
    J = np.zeros((6, 14), order="F")
    J[2, 7:] = 1.0  # every joint lifts, none does anything else
    lost.views = (J, *lost.views[1:])
    monkeypatch.setattr(law, "_hands", lost)
    with pytest.raises(
        ReflexError,
        match=r"controller_failed.*the right hand has lost a direction",
    ) as caught:
        stack.step()
    assert isinstance(caught.value.__cause__, SingularPostureError)
    assert np.isfinite(stack.applied).all()


def test_hands_claim_their_own_arm_alone(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit", ("left_hand", "right_hand"))
    refused = stack.propose(
        "moveit",
        trajectory(stack, move(plant.q, HOME + 0.05, 0.4), gripper=OPEN),
    )
    assert refused is None
    while stack.executing:
        stack.step()
    np.testing.assert_allclose(stack.manager.reference, HOME + 0.05, atol=1e-9)
    for names, why in (
        (("right_hand",), "unclaimed"),
        (("both_arms", "left_hand"), "doubly_claimed"),
    ):
        with pytest.raises(Exception, match=why):
            stack.switch_controllers(names)


@pytest.mark.parametrize("elbow_rad", [-0.3, -0.5])
def test_a_hand_that_takes_over_near_a_singularity_is_damped_for_where_it_goes(
    plant: ArmsPlant,
    elbow_rad: float,
) -> None:
    """Damping of the inertia there (thousands of Ns/m) would shake the arm on its way home."""
    q = HOME.copy()
    q[:7] = 0.0, 0.2, 0.0, elbow_rad, 0.0, 1.0 - 0.3 * elbow_rad, 0.785
    plant.reset(q)
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit", ("left_hand", "right_arm"))
    J = Kinematics().tcp_jacobians(plant.q)[0][:, :7]
    assert np.linalg.cond(J) > 70.0
    assert stack.propose("moveit", trajectory(stack, move(plant.q, HOME, 2.0))) is None
    far = 0.0
    stack.step()
    while stack.executing:
        stack.step()
        far = max(far, float(np.abs(plant.q - stack.manager.reference)[:7].max()))
    assert stack.reflex is None
    assert far < 0.1


def test_a_shift_moves_the_reference_along_the_axes_of_the_object() -> None:
    """The spring then pulls by stiffness times the shift, as far as its bound lets it."""
    held = PEG._replace(T_tcp_planned=PEG.T_tcp_object)
    law = law_of(held)
    law.shift_m = (0.001, -0.002, 0.0015)
    wrench, T = wrench_of(law, HOME, HOME, held)
    assert T[:3, :3].T @ wrench[:3] == pytest.approx([2.0, -4.0, 3.0], abs=1e-6)
    law.engage(HOME)
    assert wrench_of(law, HOME, HOME, held)[0] == pytest.approx(np.zeros(6), abs=1e-6)
