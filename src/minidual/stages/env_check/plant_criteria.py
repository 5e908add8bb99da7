"""Criteria of `env-check --plant`, in the order in which a person would look for a fault."""

from minidual.gate.criterion import Criterion

FAULTS = Criterion(
    "plant.faults",
    "==",
    why="an arm that reports a fault cannot be driven",
    remedy="{faults}: mend what it names, then recover",
)
STAMP_AGE = Criterion(
    "plant.stamp_age_max_s",
    "<=",
    unit="s",
    why="the supervisor stops arms whose measurements are older",
    remedy="look at cable, switch and network card; another plant.rate_hz does not help",
    clocked=True,
)
ARMS_APART = Criterion(
    "plant.arms_apart_max_s",
    "<=",
    unit="s",
    why="both arms must be measured at the same time, or they do not move together",
    remedy="{later} lags: look at its cable and controller",
    clocked=True,
)
LATE_TICKS = Criterion(
    "plant.late_share",
    "<=",
    why="share of control steps that came more than half a period late",
    remedy="close other programs; a real-time kernel keeps the vendor's loop on time",
    clocked=True,
)
REACHED = Criterion(
    "joints.reached",
    "==",
    why="each joint alone must reach a small step and move no other",
    remedy="{late} do not arrive: check brakes, limits and the order of the hosts",
)
SWING_RMS = Criterion(
    "tracking.sine_rms_rad",
    "<",
    unit="rad",
    why="RMS of the error norm of all joints while all swing slowly",
    remedy="look at the gains of the plant's controllers, and at what touches the arms",
)
STOPPED = Criterion(
    "control.stopped",
    "==",
    why="the arbiter must give the arms, and nothing must stop arms that follow their commands",
    remedy="{stops}: the joint, controller or contact it names comes first",
)
STOP_REST = Criterion(
    "stop.rest_s",
    "<",
    unit="s",
    why="swinging arms must come to rest after an emergency stop",
    remedy="find out what keeps pushing the arms",
)
RECOVERED = Criterion(
    "stop.recovered",
    "==",
    why="after a stop the arms must be given again, and stand where they stood",
    remedy="{reason}",
)
