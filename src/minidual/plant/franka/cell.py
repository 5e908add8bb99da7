"""Two emulated arms and hands over one simulated world, so that both hands meet one object."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from minidual.config.scene import SceneConfig
from minidual.plant.franka.arm import ArmController
from minidual.plant.franka.hand import HandController
from minidual.plant.franka.limits import DT_S, FciLimits, MeasuredState, limits_of
from minidual.plant.franka.wire import ARM_STATE, HAND_STATE, JOINTS_N, Controller, Record
from minidual.plant.servo import HandServo, JointServo
from minidual.plant.world import World
from minidual.robot.pair import SIDES, Array, Robot, pose, rot_z

_ARMS = tuple(range(len(SIDES)))
_FILTER_S = 0.01
_HAND_MASS_KG = 0.73
_HAND_CENTRE_M = (-0.01, 0.0, 0.03)
_FLANGE_TO_TCP_M = 0.1034
_GRAVITY_M_PER_S2 = -9.81
_HAND_TEMPERATURE_C = 30


class EmulatedCell:
    """Arms, hands and world of the emulator; `step` is one millisecond.

    Args:
        scene: Surroundings and objects.
        robot: Arms with seven joints.

    Attributes:
        world: The simulated world.
        arms: Controllers of the left and right arm.
        hands: Of the left and right hand.
        time_ms: Since the start.
    """

    def __init__(self, scene: SceneConfig, robot: Robot) -> None:
        self.world = World(scene, robot)
        self.robot = robot
        self.limits: FciLimits = limits_of(robot.arm)
        self._servo = JointServo(robot)
        self._hand_servos = [HandServo(arm, self.world) for arm in _ARMS]
        self._tcp = [self.world.model.body(name).id for name in robot.tcp_names]
        self._dofs = [self.world.joints.qvel[robot.joints_of(arm)] for arm in _ARMS]
        self._jacobian = np.zeros((6, self.world.model.nv))
        q = self.world.q
        self.arms = [ArmController(self.limits, q[robot.joints_of(arm)]) for arm in _ARMS]
        self.hands = [HandController(servo, robot.hand.travel_m) for servo in self._hand_servos]
        self.time_ms = 0
        self._external = np.zeros((len(SIDES), JOINTS_N))
        self._wrench = np.zeros((2, 6))
        self._T_flange_tcp = pose(rot_z(robot.arm.mount_rpy_rad[2]), (0.0, 0.0, _FLANGE_TO_TCP_M))
        self._states = [self._constant_state() for _ in _ARMS]
        self._sense()

    def step(self, commands: tuple[Record | None, Record | None]) -> None:
        """Run one millisecond with the arms' commands, None where none came in time."""
        for arm, command in zip(self.arms, commands, strict=True):
            arm.command(command)
        world = self.world
        tau = self._torques()
        fingers = np.array([servo.target() for servo in self._hand_servos])
        world.command(tau, fingers)
        world.step()
        self.time_ms += 1
        self._sense()

    def _torques(self) -> Array:
        """Return the motor torques (n,) [Nm]: those of external controllers, or the servo's."""
        q = self.world.q
        arms = self.arms
        tau = self._servo.torque(
            q,
            self.world.v,
            np.concatenate([arm.desired.q for arm in arms]),
            np.concatenate([arm.desired.v for arm in arms]),
            np.concatenate([arm.desired.a for arm in arms]),
        )
        for index, arm in enumerate(arms):
            if arm.desired.by_torque:
                joints = self.robot.joints_of(index)
                tau[joints] = arm.desired.tau + self._servo.gravity(q)[joints]
        return np.clip(tau, -self.robot.tau_max, self.robot.tau_max)

    def _sense(self) -> None:
        """Let the controllers measure."""
        world = self.world
        q = world.q
        v = world.v
        tau = world.tau
        gravity = self._servo.gravity(q)
        share = 1.0 - np.exp(-DT_S / _FILTER_S)
        for index, arm in enumerate(self.arms):
            joints = self.robot.joints_of(index)
            jacobian = self._hand_jacobian(index)
            T_base_hand = self._hand_pose(index)
            position_m = T_base_hand[:3, 3]
            speed = float(np.linalg.norm(jacobian[:3] @ v[joints]))
            state = MeasuredState(q[joints], v[joints], tau[joints], speed, position_m)
            arm.sense(state, T_base_hand, jacobian, gravity[joints])
            external = self._external_torque(self._dofs[index])
            self._external[index] += share * (external - self._external[index])
            square = jacobian @ jacobian.T + 1e-6 * np.eye(6)
            self._wrench[index] = np.linalg.solve(square, jacobian @ self._external[index])
            arm.feel(self._external[index], self._wrench[index])
        gaps_m = world.gaps_m
        grip_n = world.grip
        for index, hand in enumerate(self.hands):
            hand.tick(gaps_m[index], float(grip_n[index]))

    def _external_torque(self, dofs: NDArray[np.int64]) -> Array:
        """Return the torques (7,) of contacts and of forces from outside [Nm]."""
        data = self.world.data
        applied = (
            data.qfrc_smooth[dofs]
            + data.qfrc_bias[dofs]
            - data.qfrc_passive[dofs]
            - data.qfrc_actuator[dofs]
        )
        return data.qfrc_constraint[dofs] + applied

    def _hand_jacobian(self, arm: int) -> Array:
        """Return the Jacobian (6, 7) of a hand, in the base's axes."""
        world = self.world
        jacobian = self._jacobian
        mujoco.mj_jacBody(world.model, world.data, jacobian[:3], jacobian[3:], self._tcp[arm])
        return jacobian[:, self._dofs[arm]]

    def _hand_pose(self, arm: int) -> Array:
        """Return the pose (4, 4) of a hand in its base."""
        data = self.world.data
        body = self._tcp[arm]
        position = data.xpos[body] - self.robot.base_positions_m[arm]
        return pose(data.xmat[body].reshape(3, 3), position)

    def _constant_state(self) -> Record:
        """Return a state with its constant fields."""
        state = np.zeros((), ARM_STATE)
        identity = np.eye(4).ravel()
        state["F_T_EE"] = self._T_flange_tcp.T.ravel()
        state["F_T_NE"] = self._T_flange_tcp.T.ravel()
        state["NE_T_EE"] = identity
        state["EE_T_K"] = identity
        state["m_ee"] = _HAND_MASS_KG
        state["F_x_Cee"] = _HAND_CENTRE_M
        state["I_ee"] = np.diag([0.001, 0.0025, 0.0017]).ravel()
        state["O_ddP_O"] = (0.0, 0.0, _GRAVITY_M_PER_S2)
        return state

    def arm_state(self, index: int, message_id: int) -> bytes:
        """Return the state of an arm as it is sent."""
        arm = self.arms[index]
        desired = arm.desired
        joints = self.robot.joints_of(index)
        world = self.world
        q = world.q[joints]
        state = self._states[index]
        T = self._hand_pose(index).T.ravel()
        elbow = (q[2], np.sign(q[3]))
        state["message_id"] = message_id
        for name in ("O_T_EE", "O_T_EE_d", "O_T_EE_c"):
            state[name] = T
        for name in ("elbow", "elbow_d", "elbow_c"):
            state[name] = elbow
        state["tau_J"] = world.tau[joints]
        state["tau_J_d"] = desired.tau
        state["q"] = q
        state["theta"] = q
        state["q_d"] = desired.q
        state["dq"] = world.v[joints]
        state["dtheta"] = state["dq"]
        state["dq_d"] = desired.v
        state["ddq_d"] = desired.a
        external = self._external[index]
        wrench = self._wrench[index]
        state["tau_ext_hat_filtered"] = external
        state["O_F_ext_hat_K"] = wrench
        state["K_F_ext_hat_K"] = wrench
        state["joint_contact"] = np.abs(external) > arm.nominal.lower_torque
        state["joint_collision"] = np.abs(external) > arm.nominal.upper_torque
        state["cartesian_contact"] = np.abs(wrench) > arm.nominal.lower_force
        state["cartesian_collision"] = np.abs(wrench) > arm.nominal.upper_force
        state["motion_generator_mode"] = desired.generator_code
        controller = desired.controller
        state["controller_mode"] = Controller.OTHER if controller is None else controller
        state["errors"] = arm.flags(arm.errors)
        state["reflex_reason"] = arm.flags(arm.last_errors)
        state["robot_mode"] = arm.mode
        state["control_command_success_rate"] = arm.packets.success_rate
        return state.tobytes()

    def hand_state(self, index: int, message_id: int) -> bytes:
        """Return the state of a hand as it is sent."""
        hand = self.hands[index]
        state = np.zeros((), HAND_STATE)
        state["message_id"] = message_id
        state["width"] = self.world.gaps_m[index]
        state["max_width"] = hand.max_width_m
        state["is_grasped"] = hand.is_grasped
        state["temperature"] = _HAND_TEMPERATURE_C
        return state.tobytes()
