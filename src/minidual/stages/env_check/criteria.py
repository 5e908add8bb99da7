"""Criteria of `env-check`, in the order in which a person would look for a fault."""

from minidual.gate.criterion import Criterion
from minidual.variables import INSTALL_RENDERING

LIBRARIES = Criterion(
    "libraries.unfit",
    "==",
    why="every library must be there in a version that works",
    remedy="reinstall the locked: {unfit}",
)
JOINTS_COUNT = Criterion(
    "joints.count",
    "==",
    why="two arms, each joint a hinge with a torque motor on it",
    remedy="a joint without a motor cannot be driven: see minidual.plant.model, _add_actuators",
)
JOINTS_MAPPED = Criterion(
    "joints.mapped",
    "==",
    why="a torque on one command must accelerate its own joint as the inertia matrix predicts",
    remedy="commands {astray} move something else: check the actuators' transmissions",
)
JOINTS_REACHED = Criterion(
    "joints.reached",
    "==",
    why="each joint alone must reach a step and move no other",
    remedy="joints {late} do not arrive: check their limits, motors and inertia",
)
STEP_ERROR = Criterion(
    "tracking.step_error_rad",
    "<",
    unit="rad",
    why="error norm of all joints left by a step of joint 1 of both arms: "
    "gravity and friction are compensated",
    remedy="check the inverse dynamics (model.agreement_max) and the motors (joints.mapped) first",
)
SINE_RMS = Criterion(
    "tracking.sine_rms_rad",
    "<",
    unit="rad",
    why="RMS of the error norm of all joints while all swing",
    remedy="check the inverse dynamics and whether anything touches (contacts.sine)",
)
CONTACTS_SINE = Criterion(
    "contacts.sine",
    "==",
    why="nothing may touch while the arms swing",
    remedy="reduce env_check.sine_amplitude_rad or clear the table",
)
RISE_MAX = Criterion(
    "joints.rise_max_s",
    "<",
    unit="s",
    why="time from 10 % to 90 % of a joint's own step, slowest joint",
    remedy="{slowest}: look at its inertia, its motor's limit "
    "and the bandwidth of the reference filter",
)
OVERSHOOT_MAX = Criterion(
    "joints.overshoot_max_rad",
    "<",
    unit="rad",
    why="how far any joint goes beyond its own step",
    remedy="{farthest}: its inertia in the model is not the simulated one "
    "(model.agreement_max), or gains changed",
)
STOPPED = Criterion(
    "control.stopped",
    "==",
    why="the arbiter must give the arms, "
    "and the supervisor must not stop arms that follow their commands",
    remedy="{stops}: the joint, motor or contact it names comes first",
)
CONTACTS_HOME = Criterion(
    "contacts.home",
    "==",
    why="no link may touch anything at home, or every plan would start in collision",
    remedy="{touching}: allow the pair if it is adjacent, else move the base or the obstacle",
)
AGREEMENT_MAX = Criterion(
    "model.agreement_max",
    "<=",
    why="MuJoCo and Pinocchio must describe one robot, or controllers cancel the wrong dynamics",
    remedy="the URDF feeds both: look for an inertia, armature or frame "
    "that was changed on one side only",
)
SHAPES_UNLIKE = Criterion(
    "shapes.unlike",
    "==",
    why="no link may be drawn in another unit, place or orientation than it collides in: "
    "pictures would show other arms than those that move",
    remedy="{links}: check the scale, unit and origin of its visual and collision meshes",
)
SHAPES_ENGINES = Criterion(
    "shapes.engines_max_m",
    "<=",
    unit="m",
    why="MuJoCo and Pinocchio must collide the same shapes: bounding boxes, and edges of cubes of "
    "their volumes",
    remedy="look for a mesh that the two read differently: save it as binary STL",
)
STEP_MEDIAN = Criterion(
    "control.step_median_us",
    "<",
    unit="us",
    why="arbiter, control, supervisor and physics of one step must fit into 1 ms "
    "for 1 kHz in real time",
    remedy="close other programs; "
    "OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
    clocked=True,
)
LATE_STEPS = Criterion(
    "latency.late_steps",
    "==",
    why="a command must change the torque of the arbiter's next tick, whenever it comes",
    remedy="look for a step of delay in arbiter.tick, ControlStack.arbitrate, "
    "controller or supervisor",
)
LATENCY_MEDIAN = Criterion(
    "latency.wall_median_us",
    unit="us",
    why="computing time from propose() to the end of the step that drives the motors by it",
    clocked=True,
)
STOP_TICKS = Criterion(
    "stop.ticks",
    "==",
    why="an emergency stop must act in the next control step",
    remedy="look at Supervisor.guard and Supervisor.estop",
)
STOP_REST = Criterion(
    "stop.rest_s",
    "<",
    unit="s",
    why="swinging arms must come to rest after an emergency stop",
    remedy="raise supervisor.stop_deceleration_scale, or find out what keeps pushing the arms",
)
CONTRAST_MIN = Criterion(
    "cameras.contrast_min",
    ">",
    why="a picture of one flat colour shows nothing (standard deviation of brightness, 0 to 255)",
    remedy=INSTALL_RENDERING,
)
OBJECT_SHARE = Criterion(
    "cameras.object_share",
    ">",
    why="every object of the task must be in the picture that the policy sees",
    remedy="check the pose of camera 'high' and the object's start",
)
FINGERS_MIN = Criterion(
    "cameras.fingers_min",
    ">",
    why="each wrist camera must see both its fingertips",
    remedy="check the pose of the cameras 'left' and 'right'",
)
VIDEO_FRAMES = Criterion(
    "video.frames",
    "==",
    why="the film must show the whole swing",
    remedy="see the messages of the encoder (PyAV)",
)
