"""What does not fit between a policy and the arms is named before the first step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from minidual.errors import UsageError
from minidual.policies.facts import Driver, Place, PolicyFacts, mismatches, read_facts, require_fit
from minidual.policies.shipped import shipped_policy
from minidual.robot.pair import DUAL_PANDA

PLACE = Place((96, 128), 50.0)
NAMES = (*DUAL_PANDA.joint_names, "left_gripper", "right_gripper")
MIDDLE = np.r_[DUAL_PANDA.home, 0.5, 0.5]
SPREAD = np.full(16, 0.2)


def driver(
    *,
    cameras: dict[str, tuple[int, int]] | None = None,
    dim: int = 16,
    state_dim: int = 0,
    **facts: Any,
) -> Driver:
    own = {"high": (96, 128)} if cameras is None else cameras
    return Driver(own, state_dim or dim, dim, PolicyFacts(**facts))


def statistics(middle: np.ndarray = MIDDLE, spread: np.ndarray = SPREAD) -> dict[str, Any]:
    return {"middles": {"observation.state": middle}, "spreads": {"observation.state": spread}}


def test_what_fits_has_no_fault() -> None:
    fitting = driver(names=NAMES, rate_hz=50.0, **statistics())
    assert mismatches(fitting, DUAL_PANDA, PLACE) == []
    dotted = driver(names=tuple(f"{name}.pos" for name in NAMES))
    assert mismatches(dotted, DUAL_PANDA, PLACE) == []


def test_what_is_unknown_is_no_fault() -> None:
    assert mismatches(driver(), DUAL_PANDA, PLACE) == []


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        (driver(cameras={"top": (96, 128)}), "a camera 'top'; there are high, left, right"),
        (
            driver(cameras={"high": (480, 640)}),
            "are 640 x 480, here they are 128 x 96 (--set scene.camera.width_px=640 --set",
        ),
        (driver(dim=7), "it drives 7 numbers, here are 16: 14 joints and 2 openings"),
        (driver(state_dim=30), "its state has 30 entries and its action 16; here both have 16"),
        (
            driver(names=("left_waist", *NAMES[1:])),
            "its number 0 is 'left_waist', here it is 'left_panda_joint1'",
        ),
        (driver(rate_hz=30.0), "trained at 30 Hz, actions here come at 50 Hz"),
        (driver(units="deg"), "its joints are in 'deg', here they are in rad"),
        (
            driver(missing=("observation.state.mean",)),
            "its processors need the statistic 'observation.state.mean' and lack it",
        ),
        (
            driver(**statistics(np.degrees(MIDDLE), np.degrees(SPREAD))),
            "lie at 0 +- 11.46, here the range is -2.897 to 2.897 (rad): other units, or other joints",
        ),
        (
            driver(**statistics(MIDDLE * np.r_[np.ones(14), 100.0, 100.0])),
            "'left_gripper' in observation.state lie at 50 +- 0.2, here the range is 0 to 1",
        ),
        (driver(**statistics(MIDDLE[:7], SPREAD[:7])), "observation.state have shape (7,)"),
    ],
)
def test_what_does_not_fit_is_named(wrong: Driver, fault: str) -> None:
    faults = mismatches(wrong, DUAL_PANDA, PLACE)
    assert any(fault in text for text in faults), faults


def test_all_faults_are_named_at_once_and_many_of_a_kind_are_counted() -> None:
    wrong = driver(cameras={"top": (96, 128)}, names=tuple("abcdefghijklmnop"), rate_hz=10.0)
    with pytest.raises(UsageError) as refused:
        require_fit(wrong, DUAL_PANDA, PLACE, "theirs")
    text = str(refused.value)
    assert "the policy theirs does not fit this robot" in text
    assert "camera 'top'" in text
    assert "and 13 more of this kind" in text
    assert "10 Hz" in text


def checkpoint(folder: Path, **tensors: np.ndarray) -> Path:
    folder.mkdir()
    features = {"observation.state": {"type": "STATE", "shape": [16]}}
    record = {
        "type": "act",
        "input_features": features,
        "output_features": {"action": {"type": "ACTION", "shape": [16]}},
        "normalization_mapping": {"STATE": "MIN_MAX", "ACTION": "MEAN_STD"},
    }
    (folder / "config.json").write_text(json.dumps(record))
    save_file(tensors, folder / "policy_preprocessor_step_3_normalizer_processor.safetensors")
    return folder


def test_a_checkpoint_tells_its_statistics_and_what_it_lacks(tmp_path: Path) -> None:
    low, high = np.zeros(16, np.float32), np.full(16, 4.0, np.float32)
    facts = read_facts(
        checkpoint(
            tmp_path / "policy",
            **{"observation.state.min": low, "observation.state.max": high, "action.mean": low},
        ),
    )
    np.testing.assert_allclose(facts.middles["observation.state"], 2.0)
    np.testing.assert_allclose(facts.spreads["observation.state"], 1.0)
    assert facts.missing == ("action.std",)
    assert facts.rate_hz is None


@pytest.mark.parametrize("names", [list(NAMES), {"motors": list(NAMES)}])
def test_rate_and_names_are_those_of_the_dataset_if_it_is_here(tmp_path: Path, names: Any) -> None:
    folder = checkpoint(tmp_path / "policy")
    dataset = tmp_path / "dataset"
    (dataset / "meta").mkdir(parents=True)
    info = {"fps": 30, "features": {"action": {"names": names}}}
    (dataset / "meta" / "info.json").write_text(json.dumps(info))
    trained = {"dataset": {"repo_id": "local/x", "root": str(dataset)}}
    (folder / "train_config.json").write_text(json.dumps(trained))
    facts = read_facts(folder)
    assert facts.rate_hz == 30.0
    assert facts.names == NAMES


def test_statistics_of_inputs_are_not_compared_with_joints() -> None:
    """A torque of 80 Nm is no joint in degrees."""
    more = np.r_[MIDDLE, np.full(14, 80.0)]
    facts = PolicyFacts(**statistics(more, np.full(30, 0.2)))
    feeling = Driver({"high": (96, 128)}, 16, 16, facts.without_inputs(16))
    assert mismatches(feeling, DUAL_PANDA, PLACE) == []
    assert facts.middles["observation.state"].shape == (30,)


def test_the_policies_of_the_package_fit() -> None:
    folder = shipped_policy("rod_carry")
    facts = read_facts(folder)
    assert set(facts.middles) == {"observation.state", "action"}
    assert mismatches(Driver({"high": (96, 128)}, 16, 16, facts), DUAL_PANDA, PLACE) == []
