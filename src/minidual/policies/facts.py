"""Facts of a checkpoint about its robot and training data, and whether they fit.

A network maps numbers to numbers: with other units, joints or rates it moves arms all the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from minidual.demos.lerobot_reader import ACTION, STATE
from minidual.durable import expanded, read_json
from minidual.errors import MinidualError, UsageError
from minidual.robot.pair import GRIPPERS_N, Array, Robot

_NEEDED = {
    "MEAN_STD": ("mean", "std"),
    "MIN_MAX": ("min", "max"),
    "QUANTILES": ("q01", "q99"),
    "QUANTILE10": ("q10", "q90"),
    "IDENTITY": (),
}
"""Statistics by way of normalisation."""
_TOLERANCE = 0.5
"""[rad], and share of an opening: data may lie so far outside of the range of a joint."""
_NAMED_MAX = 3


@dataclass(frozen=True)
class PolicyFacts:
    """Known facts of a policy's training.

    Attributes:
        names: Of the numbers of state and action; None: unknown.
        rate_hz: Of its data; None: unknown.
        units: Of its joints, if it says so.
        middles: {"observation.state" or "action": (dim,)}, means of its data.
        spreads: The same, standard deviations.
        missing: Statistics that its processors need and lack.
    """

    names: tuple[str, ...] | None = None
    rate_hz: float | None = None
    units: str = "rad"
    middles: Mapping[str, Array] = field(default_factory=dict)
    spreads: Mapping[str, Array] = field(default_factory=dict)
    missing: tuple[str, ...] = ()

    def without_inputs(self, entries: int) -> "PolicyFacts":
        """Return the same for joints and openings alone, the first `entries` of a state."""
        middles = dict(self.middles)
        spreads = dict(self.spreads)
        for statistics in (middles, spreads):
            if STATE in statistics:
                statistics[STATE] = statistics[STATE][:entries]
        return replace(self, middles=middles, spreads=spreads)


class Place(NamedTuple):
    """Where a policy is to drive.

    Attributes:
        picture_px: Height and width of the cameras' pictures.
        rate_hz: Of its actions.
    """

    picture_px: tuple[int, int]
    rate_hz: float


class Driver(NamedTuple):
    """Inputs and outputs of a policy.

    Attributes:
        cameras: (H, W) by camera.
        state_dim, dim: Entries of a state without inputs, and of an action.
        facts: What is known of its training.
    """

    cameras: Mapping[str, tuple[int, int]]
    state_dim: int
    dim: int
    facts: PolicyFacts


def read_facts(folder: Path) -> PolicyFacts:
    """Return the facts of a LeRobot checkpoint, without its network.

    Its rate and its names are those of the dataset, if that lies where it was trained on.

    Raises:
        DataError: A file is damaged.
    """
    statistics = _statistics(folder)
    config = read_json(folder / "config.json")
    middles: dict[str, Array] = {}
    spreads: dict[str, Array] = {}
    for key in (STATE, ACTION):
        if f"{key}.mean" in statistics and f"{key}.std" in statistics:
            middles[key] = statistics[f"{key}.mean"]
            spreads[key] = statistics[f"{key}.std"]
        elif f"{key}.min" in statistics and f"{key}.max" in statistics:
            low = statistics[f"{key}.min"]
            high = statistics[f"{key}.max"]
            middles[key] = (low + high) / 2.0
            spreads[key] = (high - low) / 4.0
    info = _dataset_info(folder)
    return PolicyFacts(
        names=_names(info),
        rate_hz=float(info["fps"]) if "fps" in info else None,
        middles=middles,
        spreads=spreads,
        missing=_missing(config, statistics),
    )


def mismatches(driver: Driver, robot: Robot, place: Place | None = None) -> list[str]:
    """Return a sentence for each thing that does not fit, none for a policy that does."""
    facts = driver.facts
    faults = [*_camera_faults(driver.cameras, place), *_joint_faults(driver, robot)]
    faults += _rate_faults(facts.rate_hz, place)
    if facts.units != "rad":
        faults.append(f"its joints are in '{facts.units}', here they are in rad")
    faults += [f"its processors need the statistic '{name}' and lack it" for name in facts.missing]
    if driver.dim == robot.dof + GRIPPERS_N:
        faults += _range_faults(facts, robot)
    return faults


def require_fit(driver: Driver, robot: Robot, place: Place | None, source: str) -> None:
    """Raise UsageError that names all that does not fit."""
    faults = mismatches(driver, robot, place)
    if not faults:
        return
    raise UsageError(
        f"the policy {source} does not fit this robot:\n  " + "\n  ".join(faults),
        remedy="take a policy that was trained on data of these arms and cameras (docs/lerobot.md)",
    )


def _camera_faults(
    cameras: Mapping[str, tuple[int, int]],
    place: Place | None,
) -> list[str]:
    from minidual.plant.cameras import CAMERAS  # tables of policies are read without a simulator

    faults: list[str] = []
    for camera, (height, width) in cameras.items():
        if camera not in CAMERAS:
            faults.append(f"it reads a camera '{camera}'; there are {', '.join(CAMERAS)}")
        elif place is not None and place.picture_px != (height, width):
            faults.append(
                f"its pictures of camera '{camera}' are {width} x {height}, here they are"
                f" {place.picture_px[1]} x {place.picture_px[0]}"
                f" (--set scene.camera.width_px={width} --set scene.camera.height_px={height})",
            )
    return faults


def _rate_faults(rate_hz: float | None, place: Place | None) -> list[str]:
    if rate_hz is None or place is None or abs(rate_hz - place.rate_hz) <= 0.01 * place.rate_hz:
        return []
    text = f"it was trained at {rate_hz:g} Hz, actions here come at {place.rate_hz:g} Hz"
    return [f"{text} (--set teleop.rate_hz=..., 40 to 100)"]


def _joint_faults(driver: Driver, robot: Robot) -> list[str]:
    entries_here = (*robot.joint_names, *(f"{side}_gripper" for side in robot.sides))
    if driver.state_dim != driver.dim:
        entries = f"its state has {driver.state_dim} entries and its action {driver.dim}"
        return [f"{entries}; here both have {len(entries_here)}"]
    if driver.dim != len(entries_here):
        numbers = f"{robot.dof} joints and {GRIPPERS_N} openings"
        return [f"it drives {driver.dim} numbers, here are {len(entries_here)}: {numbers}"]
    names = driver.facts.names
    if names is None:
        return []
    faults: list[str] = []
    for place, (name, expected) in enumerate(zip(names, entries_here, strict=False)):
        if name.removesuffix(".pos") != expected:
            faults.append(f"its number {place} is '{name}', here it is '{expected}'")
    return _shortened(faults)


def _range_faults(facts: PolicyFacts, robot: Robot) -> list[str]:
    """Return where the data lie outside of the range of a joint or an opening."""
    names = (*robot.joint_names, *(f"{side}_gripper" for side in robot.sides))
    lower = np.concatenate([robot.q_lower, np.zeros(GRIPPERS_N)])
    upper = np.concatenate([robot.q_upper, np.ones(GRIPPERS_N)])
    faults: list[str] = []
    for key, middle in facts.middles.items():
        spread = facts.spreads[key]
        if middle.shape != lower.shape or spread.shape != lower.shape:
            faults.append(f"its statistics of {key} have shape {middle.shape}, not {lower.shape}")
            continue
        outside = (middle < lower - _TOLERANCE) | (middle > upper + _TOLERANCE)
        too_wide = spread > (upper - lower) / 2.0 + _TOLERANCE
        entry_faults = [
            f"its data of '{names[i]}' in {key} lie at {middle[i]:.4g} +- {spread[i]:.4g},"
            f" here the range is {lower[i]:.4g} to {upper[i]:.4g}"
            f" ({'rad' if i < robot.dof else 'share of the opening'}): other units, or other joints"
            for i in np.flatnonzero(outside | too_wide)
        ]
        faults += _shortened(entry_faults)
    return faults


def _shortened(faults: Sequence[str]) -> list[str]:
    rest = len(faults) - _NAMED_MAX
    shown = list(faults[:_NAMED_MAX])
    return [*shown, f"and {rest} more of this kind"] if rest > 0 else shown


def _statistics(folder: Path) -> dict[str, Array]:
    """Return the statistics of the preprocessor by name."""
    from safetensors.numpy import load_file

    statistics: dict[str, Array] = {}
    for path in sorted(folder.glob("policy_*processor_step_*.safetensors")):
        for name, values in load_file(path).items():
            statistics[name] = np.asarray(values, dtype=float)
    return statistics


def _missing(config: Mapping[str, Any], statistics: Mapping[str, Array]) -> tuple[str, ...]:
    modes = config.get("normalization_mapping") or {}
    features = {**(config.get("input_features") or {}), **(config.get("output_features") or {})}
    missing: list[str] = []
    for name, feature in features.items():
        for statistic in _NEEDED.get(modes.get(feature.get("type"), "IDENTITY"), ()):
            if f"{name}.{statistic}" not in statistics:
                missing.append(f"{name}.{statistic}")
    return tuple(missing)


def _dataset_info(folder: Path) -> dict[str, Any]:
    """Return meta/info.json of the dataset that a checkpoint was trained on; empty if it is not here."""
    try:
        dataset = read_json(folder / "train_config.json")["dataset"]
        root = dataset.get("root")
        if root is None:
            from lerobot.utils.constants import HF_LEROBOT_HOME

            root = HF_LEROBOT_HOME / dataset["repo_id"]
        info = read_json(expanded(str(root)) / "meta" / "info.json")
    except (MinidualError, OSError, KeyError, TypeError, AttributeError):
        return {}
    return info if isinstance(info, dict) else {}


def _names(info: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the names of the actions of a dataset, a list or the lists of a mapping."""
    names = ((info.get("features") or {}).get(ACTION) or {}).get("names")
    if isinstance(names, dict):
        names = [name for group in names.values() for name in group]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return None
    return tuple(names)
