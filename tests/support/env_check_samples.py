"""Measurements of `env-check`, sound and broken, and its rig with bounds of the supervisor."""

from dataclasses import replace

import numpy as np

from minidual.config.control import EnvCheckConfig, SupervisorConfig
from minidual.config.root import Config
from minidual.gate.check import Check
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check.checks import Measurements, installation_checks, measured_checks
from minidual.stages.env_check.installation import Library
from minidual.stages.env_check.pictures import CameraCheck
from minidual.stages.env_check.responses import CommandLatency, JointResponse, StopResponse
from minidual.stages.env_check.rig import TrackingRig
from minidual.stages.env_check.shapes import Extent, LinkShapes, ShapeComparison
from minidual.stages.env_check.tracking import Tracking

DOF = DUAL_PANDA.dof
HOME = DUAL_PANDA.home
JOINT_NAMES = DUAL_PANDA.joint_names
QUICK = EnvCheckConfig(sine_duration_s=2.0, agreement_states_n=4)


def rig_of(world: World, kinematics: Kinematics, **supervisor: float) -> TrackingRig:
    """Return a rig; `supervisor`: its bounds."""
    config = Config(supervisor=SupervisorConfig.model_validate(supervisor))
    return TrackingRig(world, kinematics, config)


def response(joint: str, rise_s: float, overshoot_rad: float, settled_rad: float) -> JointResponse:
    """Return the response of a joint whose swing has no error."""
    return JointResponse(
        joint=joint,
        step_rad=0.1,
        rise_s=rise_s,
        overshoot_rad=overshoot_rad,
        settled_rad=settled_rad,
        sine_rms_rad=0.0,
        sine_peak_rad=0.0,
    )


def _at_rest() -> Tracking:
    still = np.zeros((300, DOF))
    return Tracking(np.arange(300) * 1e-3, still, still, HOME)


SOUND = Measurements(
    moved=tuple(range(DOF)),
    contacts=[],
    steps=[_at_rest()] * DOF,
    responses=[response(name, 0.1, 0.0, 0.0) for name in JOINT_NAMES],
    step=_at_rest(),
    sine=_at_rest(),
    agreement={"position_m": 0.0},
    latency=CommandLatency((1, *range(20, 1, -1)), 100.0),
    stop=StopResponse(1, 0.3, 1.0),
    cameras=CameraCheck(30.0, 0.1, 0.1, "none"),
    frames=round(QUICK.sine_duration_s * FILM_FPS),
    shapes=ShapeComparison({}),
)
"""Measurements in which all is well."""


def judged(**changes: object) -> dict[str, Check]:
    """Return the checks of sound measurements, with some fields changed, by name."""
    measurements = replace(SOUND, **changes)
    checks = measured_checks(measurements, QUICK, DUAL_PANDA)
    return {check.name: check for check in checks}


def failing(checks: dict[str, Check]) -> set[str]:
    """Return the names of the checks that fail."""
    return {name for name, check in checks.items() if check.passed is False}


def box(size_m: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return corners and volume of a cube about the origin."""
    half = 0.5 * size_m * np.ones(3)
    return -half, half, size_m**3


def all_failing_checks() -> list[Check]:
    """Return every check with a limit, from measurements in which everything is broken."""
    nan = float("nan")
    lost = Tracking(
        t=np.arange(300) * 1e-3,
        reference=np.full((300, DOF), nan),
        measured=np.zeros((300, DOF)),
        start=HOME,
        contacts=3,
        step_us=nan,
        stopped="joint_speed: too fast",
    )
    checks = judged(
        moved=(-1,) * DOF,
        contacts=[("left_panda_hand", "table", -0.01)],
        responses=[response(name, nan, nan, nan) for name in JOINT_NAMES],
        step=lost,
        sine=lost,
        agreement={"position_m": nan},
        latency=CommandLatency((60,) * 20, nan),
        stop=StopResponse(0, nan, nan),
        cameras=CameraCheck(0.0, 0.0, 0.0, "none"),
        frames=0,
        shapes=ShapeComparison(
            {"left_panda_hand": LinkShapes(Extent(*box(10.0)), Extent(*box(1.0)), None)},
        ),
    )
    missing = [Library("mujoco", ">=4", None)]
    installed = installation_checks(missing, DOF - 1, DUAL_PANDA)
    return [check for check in (*installed, *checks.values()) if check.op]
