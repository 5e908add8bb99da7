"""The world: what resets, what its sensors say, and how it says that it broke."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.control.joint_control import JointLoop
from minidual.errors import UsageError
from minidual.plant.bodies import contact_sensor
from minidual.plant.world import SimulationDivergedError, World
from tests.support.arm_scripts import pinch_rod
from tests.support.panda import DOF, HOME, TAU_MAX

ZERO = np.zeros(DOF)
OPEN = np.full(2, 0.04)


def run(world, steps, tau):
    for _ in range(steps):
        world.command(tau, OPEN)
        world.step()


@pytest.fixture(scope="module")
def pinched(scene, compiled_model):
    """Both hands pinch the rod where it lies."""
    from minidual.robot.kinematics import Kinematics

    world = World(scene, model=compiled_model)
    kinematics = Kinematics()
    loop = JointLoop(world, kinematics)
    q = pinch_rod(loop, scene, kinematics)
    return world, loop, q


class TestReset:
    def test_arms_are_home_hands_open_and_the_rod_on_its_mark(self, world, scene):
        assert np.array_equal(world.q, HOME)
        assert not world.v.any()
        assert world.gripper == pytest.approx([1.0, 1.0])
        assert world.object_pose()[:3, 3] == pytest.approx(
            [*scene.task.start_xy_m, scene.object.radius_m],
        )
        assert world.on_table()

    def test_rolling_out_twice_from_a_reset_gives_the_same_bytes(self, world):
        def rollout():
            world.reset(poses={"rod": (0.48, 0.2, 0.1)})
            run(world, 200, 0.05 * TAU_MAX)
            return (
                world.data.qpos.tobytes()
                + world.data.qvel.tobytes()
                + world.data.sensordata.tobytes()
            )

        first = rollout()
        run(world, 37, -0.2 * TAU_MAX)
        assert rollout() == first

    def test_the_rod_lies_where_it_was_put(self, world):
        world.reset(poses={"rod": (0.45, 0.1, 0.3)})
        assert world.object_pose()[:3, 1] == pytest.approx([-np.sin(0.3), np.cos(0.3), 0.0])

    def test_the_goal_mark_lies_where_and_as_it_is_told(self, scene):
        world = World(scene)
        world.mark_goal(0.51, -0.27, 0.25)
        mujoco.mj_forward(world.model, world.data)
        mark = world.data.geom("goal_mark")
        assert mark.xpos[:2] == pytest.approx([0.51, -0.27])
        assert mark.xmat.reshape(3, 3)[:, 1] == pytest.approx([-np.sin(0.25), np.cos(0.25), 0.0])

    def test_a_bad_posture_is_refused_by_name(self, world):
        q = HOME.copy()
        q[3] = 0.5
        with pytest.raises(
            UsageError,
            match=r"left_panda_joint4 = 0\.5 rad; -3\.0718 <= value <= -0\.0698",
        ):
            world.reset(q)
        q[3] = np.nan
        with pytest.raises(UsageError, match="left_panda_joint4 = nan"):
            world.reset(q)
        with pytest.raises(UsageError, match=r"shape \(7,\)"):
            world.reset(HOME[:7])

    def test_a_posture_rounded_to_float32_is_on_the_limit(self, world):
        q = HOME.copy()
        q[3] = np.float32(world.robot.q_upper[3])
        assert q[3] > world.robot.q_upper[3]
        world.reset(q)
        assert world.q[3] == world.robot.q_upper[3]


class TestReadings:
    def test_readings_are_copies(self, world):
        q = world.q
        run(world, 5, 0.1 * TAU_MAX)
        assert np.array_equal(q, HOME)
        assert not np.array_equal(world.q, HOME)

    def test_torques_beyond_the_motors_are_clipped(self, world):
        run(world, 1, 10.0 * TAU_MAX)
        assert np.array_equal(world.tau, TAU_MAX)

    def test_the_rods_twist_is_the_rate_of_its_pose(self, world):
        rod = world.truth()
        rod.qpos[2] = 0.5
        rod.qpos[3:] = [0.8, 0.0, 0.6, 0.0]
        rod.qvel[:] = [0.1, -0.2, 0.3, 1.0, 2.0, -1.0]
        mujoco.mj_forward(world.model, world.data)
        before = world.object_pose()
        twist = world.truth().twist()
        h = 1e-7
        mujoco.mj_integratePos(world.model, world.data.qpos, world.data.qvel, h)
        mujoco.mj_forward(world.model, world.data)
        rate = (world.object_pose() - before) / h
        assert rate[:3, 3] == pytest.approx(twist[:3], abs=1e-6)
        spin = rate[:3, :3] @ before[:3, :3].T
        assert [spin[2, 1], spin[0, 2], spin[1, 0]] == pytest.approx(twist[3:], abs=1e-5)

    def test_a_rod_in_the_air_is_not_on_the_table(self, world):
        world.truth().qpos[2] = 0.3
        mujoco.mj_forward(world.model, world.data)
        assert not world.on_table()
        assert world.data.ncon == 0


class TestContacts:
    def test_nobody_pinches_an_untouched_rod(self, world):
        assert world.truth().pinch().tolist() == [0.0, 0.0]
        assert world.truth().internal_force() == 0.0

    def test_the_pinch_is_steady_and_as_strong_as_asked(self, pinched):
        world, loop, q = pinched
        forces = []
        for _ in range(300):
            loop.step(q, np.zeros(2))
            forces.append(world.truth().pinch())
        # Bare 15 g fingers chatter here, between nothing and the fingers' limit.
        assert np.ptp(forces, axis=0).max() < 0.5
        assert np.mean(forces, axis=0) == pytest.approx([60.0, 60.0], abs=1.0)

    def test_sensors_add_up_to_the_contacts_themselves(self, pinched):
        world, *_ = pinched
        model = world.model
        data = world.data
        for arm, measured in zip(("left", "right"), world.truth().forces(), strict=True):
            force = np.zeros(3)
            for i in range(data.ncon):
                contact = data.contact[i]
                bodies = [
                    model.body(int(model.geom_bodyid[g])).name
                    for g in (contact.geom1, contact.geom2)
                ]
                if "rod" not in bodies or not any(b.startswith(f"{arm}_") for b in bodies):
                    continue
                local = np.zeros(6)
                mujoco.mj_contactForce(model, data, i, local)
                axes = contact.frame.reshape(3, 3).T
                sign = (
                    1.0 if bodies[1] == "rod" else -1.0
                )  # a contact's force acts on its second geom
                force += sign * axes @ local[:3]
            assert np.linalg.norm(force) < 30.0  # the two fingers nearly cancel
            assert measured == pytest.approx(force, abs=1e-9)

    def test_a_pinch_needs_both_fingers(self, pinched):
        world, *_ = pinched
        assert world.truth().pinch().min() > 50.0
        held = world.data.sensordata.copy()
        start = int(world.model.sensor(contact_sensor("rod", "left", "panda_leftfinger")).adr[0])
        world.data.sensordata[start : start + 3] = 0.0
        try:
            assert world.truth().pinch()[0] == 0.0
            assert world.truth().pinch()[1] > 50.0
        finally:
            world.data.sensordata[:] = held

    def test_the_hands_squeeze_as_they_are_pushed_together(self, pinched, scene):
        """Pushed together by joint torques J^T f, the rod carries f; pulled apart it carries -f."""
        from minidual.robot.kinematics import Kinematics

        world, loop, q = pinched
        kinematics = Kinematics()
        axis = world.object_pose()[:3, 1]
        state = world.data.qpos.copy(), world.data.qvel.copy(), world.data.ctrl.copy()
        readings = {}
        for push in (15.0, -15.0):
            world.data.qpos[:], world.data.qvel[:], world.data.ctrl[:] = state
            left, right = kinematics.tcp_jacobians(world.q)
            tau = (
                -push * left[:3].T @ axis + push * right[:3].T @ axis
            )  # left hand towards -y, right towards +y
            zero = np.zeros(DOF)
            for _ in range(400):
                stiff = loop.controller.torque(world.q, world.v, q, zero, zero)
                # Joint stiffness holds the pose; it shares the push with the rod.
                fingers_m = loop.grippers.step(np.zeros(2), world.fingers, world.grip)
                world.command(stiff + tau, fingers_m)
                world.step()
            readings[push] = world.truth().internal_force()
        assert readings[15.0] > 3.0
        assert readings[-15.0] < -3.0

    def test_one_hand_alone_squeezes_nothing(self, scene, compiled_model, kinematics):
        world = World(scene, model=compiled_model)
        pinch_rod(JointLoop(world, kinematics), scene, kinematics, hands=np.array([0.0, 1.0]))
        assert world.truth().pinch()[0] > 50.0
        assert world.truth().pinch()[1] == 0.0
        assert world.truth().internal_force() <= 1e-9


@pytest.mark.usefixtures("quiet_mujoco")
class TestDivergence:
    def test_a_nan_torque_is_not_swallowed(self, world):
        tau = ZERO.copy()
        tau[4] = np.nan
        with pytest.raises(SimulationDivergedError, match="commands not finite"):
            run(world, 1, tau)

    @pytest.mark.parametrize(("field", "what"), [("qpos", "positions"), ("qvel", "velocities")])
    def test_a_state_that_is_not_finite_is_not_reset_in_silence(self, world, field, what):
        run(world, 10, ZERO)
        getattr(world.data, field)[3] = np.nan
        with pytest.raises(
            SimulationDivergedError,
            match=rf"t = 0\.010 s \({what} not finite\)",
        ) as caught:
            run(world, 1, ZERO)
        assert caught.value.remedy

    def test_an_explosion_is_named(self, world):
        world.data.qvel[world.joints.qvel] = 1e9
        with pytest.raises(SimulationDivergedError):
            run(world, 20, ZERO)

    def test_a_reset_mends_it(self, world):
        tau = np.full(DOF, np.nan)
        with pytest.raises(SimulationDivergedError):
            run(world, 1, tau)
        world.reset()
        run(world, 10, ZERO)
        assert np.isfinite(world.q).all()


def test_a_scene_holds_several_named_objects_lying_and_upright() -> None:
    bottle = ObjectConfig(
        name="bottle",
        upright=True,
        length_m=0.2,
        radius_m=0.03,
        grasp_offset_m=0.0,
        xy_m=(0.45, -0.1),
        mass_kg=0.3,
    )
    crate = ObjectConfig(
        name="crate",
        shape="box",
        upright=True,
        length_m=0.18,
        width_m=0.05,
        grasp_offset_m=0.0,
        xy_m=(0.6, -0.3),
    )
    world = World(SceneConfig(more=(bottle, crate)))
    assert world.objects == ("rod", "bottle", "crate")
    for item in (bottle, crate):
        body = world.model.body(item.name)
        assert np.allclose(sorted(body.inertia), sorted(item.inertia_kg_m2), rtol=1e-9)
        assert world.object_pose(item.name)[:3, 3] == pytest.approx([*item.xy_m, item.length_m / 2])
    world.reset(poses={"bottle": (0.5, -0.05, 0.4)})
    while world.time < 0.3:
        world.step()
    for item in (bottle, crate):  # they stand, and do not sink
        assert world.on_table(item.name)
        assert world.object_pose(item.name)[2, 2] > 0.9999
        assert world.object_pose(item.name)[2, 3] == pytest.approx(item.rest_height_m, abs=3e-4)
    assert world.object_pose("bottle")[:2, 3] == pytest.approx([0.5, -0.05], abs=1e-4)
    with pytest.raises(ValueError, match="one name"):
        SceneConfig(more=(bottle, bottle))
