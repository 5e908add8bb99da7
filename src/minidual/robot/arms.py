"""The table of arms. Add a row to add an arm; nothing else in the package knows one arm from another."""

from __future__ import annotations

from minidual.registry import Registry
from minidual.robot.pair import ArmModel, HandModel, Robot

PANDA_HAND = HandModel(
    name="panda_hand",
    finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
    finger_links=("panda_leftfinger", "panda_rightfinger"),
    palm_link="panda_hand",
    tcp_link="panda_hand_tcp",
    travel_m=0.04,
    force_max_n=70.0,  # Franka Hand data sheet
    # The URDF's bare finger weighs 15 g; at 1 kHz a 15 g mass between a position servo and a stiff contact chatters: the
    # pinch jumps between 0 and 70 N. It is steady from 0.1 kg up and chatters at 0.05.
    finger_armature_kg=0.2,
)

PANDA = ArmModel(
    name="panda",
    joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    base_link="panda_link0",
    home=(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
    # Position, velocity and torque: the URDF of panda_description (Franka Emika, Apache-2.0).
    q_lower=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    q_upper=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    v_max=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    tau_max=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # Acceleration, jerk and torque rate: Franka Control Interface documentation, "Robot and interface specifications".
    a_max=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk_max=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    tau_rate_max=1000.0,
    armature=0.1,  # the value that MuJoCo Menagerie identified for the Panda
    damping=0.1,
    friction=0.0,
    hand=PANDA_HAND,
)

ARM_MODELS: Registry[ArmModel] = Registry("arm", {"panda": PANDA}, group="minidual.arms")

DUAL_PANDA = Robot(PANDA, ((0.0, 0.25, 0.0), (0.0, -0.25, 0.0)))
