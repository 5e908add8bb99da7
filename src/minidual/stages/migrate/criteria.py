"""Criteria of the migration: twelve rows of the checklist, and those that each step adds.

`row01` to `row12` are the rows; a step checks those that it can.
"""

from minidual.gate.criterion import Criterion

INTERFACE = Criterion(
    "row01.interface_faults",
    "==",
    why="the plant must answer, and no arm may report a fault",
    remedy="{faults}: mend what it names, then recover",
)
CONTROLLERS = Criterion(
    "row02.controllers_wrong",
    "==",
    why="controllers A and B must take over, and C only where the plant takes torques",
    remedy="{wrong}: look at the kinds of command of the plant",
)
LIMITS = Criterion(
    "row03.limits_off_rad",
    "<=",
    unit="rad",
    why="joint limits of plant and arm model must agree, or plans stop at a limit",
    remedy="{joint}: correct the arm model, or the limits in the controller",
)
APPROACH = Criterion(
    "row03.approach_error_rad",
    "<=",
    unit="rad",
    why="each joint, moved slowly to both sides, must get there",
    remedy="{joint} stays behind: look for a narrower limit, a brake, or swapped arms",
)
JITTER = Criterion(
    "row04.jitter_p99_s",
    "<=",
    unit="s",
    why="control steps must come evenly (99th percentile of the deviation from the period)",
    remedy="close other programs; use a real-time kernel and a network card of its own",
    clocked=True,
)
LATENCY = Criterion(
    "row04.latency_s",
    "<=",
    unit="s",
    why="from a target to the motion half way: what is later feels loose and rings",
    remedy="raise plant.rate_hz; look at cable and switch",
)
GRAVITY = Criterion(
    "row05.gravity_share",
    "<=",
    why="at rest the torques must be those of gravity (share of the motors' limits)",
    remedy="{joint}: set the mass of hand and load in the controller",
)
SAG = Criterion(
    "row05.sag_rad",
    "<=",
    unit="rad",
    why="arms that hold must not sink",
    remedy="{joint} sinks: look at load and brakes",
)
SOFT_OVERSHOOT = Criterion(
    "row06.soft_overshoot_rad",
    "<=",
    unit="rad",
    why="a step with 25 % lower gains must not overshoot",
    remedy="{joint} overshoots: lower its gains further, or look for play",
)
SOFT_ERROR = Criterion(
    "row06.soft_error_rad",
    "<=",
    unit="rad",
    why="a step with 25 % lower gains must still arrive",
    remedy="{joint} does not arrive: look at friction and load",
)
MESHES = Criterion(
    "row07.meshes_small",
    "==",
    why="collision shapes must cover what is drawn, or plans touch it",
    remedy="{links}: a collision shape is smaller than the link",
)
FOCAL = Criterion(
    "row08.focal_error_share",
    "<=",
    why="each camera's focal length, from pictures of a checkerboard, must be the model's",
    remedy="{camera}: see that the pictures are that camera's, then set its field of view",
)
REPROJECTION = Criterion(
    "row08.reprojection_px",
    "<=",
    unit="px",
    why="corners of the board must fall where the calibration puts them",
    remedy="{camera}: take sharper pictures, from more sides",
)
HAND_OPEN = Criterion(
    "row09.open_share",
    ">=",
    why="each hand must open as far as the model's (share of its width)",
    remedy="{hand}: home it, or look at its fingers",
)
HAND_CLOSED = Criterion(
    "row09.closed_m",
    "<=",
    unit="m",
    why="each empty hand must close",
    remedy="{hand}: home it, and see what is between its fingers",
)
SPEED = Criterion(
    "row10.speed_share",
    "<=",
    why="no joint may exceed this step's share of its speed limit",
    remedy="{joint} was faster: look at arbiter.speed_override and the plant's own scaling",
)
STOP = Criterion(
    "row11.rest_s",
    "<",
    unit="s",
    why="the emergency stop must bring moving arms to rest",
    remedy="find out what keeps the arms moving",
)
SIGNED = Criterion(
    "row11.unsigned",
    "==",
    why="a person must have tried the stop button, mains and cable on hardware",
    remedy="try {rows}, then add --confirm {rows} --signed-by NAME",
)
STATISTICS = Criterion(
    "row12.statistics_off_rad",
    "<=",
    unit="rad",
    why="mean and spread of recorded joints must be the simulation's of the same motion",
    remedy="{joint}: normalise with statistics of this plant's data, not of another robot's",
)
STOPPED = Criterion(
    "step.stops",
    "==",
    why="nothing may stop arms that follow their commands",
    remedy="{stops}",
)
TRACKING = Criterion(
    "step.tracking_rms_rad",
    "<=",
    unit="rad",
    why="the driven arms must follow a swing of all joints (RMS of the error norm)",
    remedy="look at row04 (latency) and row06 (gains)",
)
RESTING_ARM = Criterion(
    "step.resting_arm_rad",
    "<=",
    unit="rad",
    why="the arm that is not driven must stay where it is",
    remedy="look at the order of the hosts: left, then right",
)
SYNCHRONY = Criterion(
    "step.arms_apart_s",
    "<=",
    unit="s",
    why="both arms must be half way at the same time, or they tear what they hold",
    remedy="{later} is later: look at its cable and controller",
)
TORQUE = Criterion(
    "step.torque_share",
    "<=",
    why="no motor may come near its limit (share of it)",
    remedy="{joint}: slow down, or look at its load",
)
LEADER_LATENCY = Criterion(
    "step.leader_latency_s",
    "<=",
    unit="s",
    why="arms must follow a leader's hand closely enough to steer by sight",
    remedy="raise plant.rate_hz; look at row04",
)
WORKSPACE = Criterion(
    "step.workspace_missed",
    "==",
    why="the leader must be able to lead the arms where tasks are done",
    remedy="{postures}: look at limits and at what stands in the way",
)
INDICATORS = Criterion(
    "step.indicator_share",
    ">=",
    why="each indicator must reach this share of the simulation's",
    remedy="{indicator} falls behind the simulation",
)
