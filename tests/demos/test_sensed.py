"""Forces that a policy reads: what is measured, in the order it asks, or a refusal by name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from minidual.demos.schema import SIGNALS
from minidual.demos.sensed import SENSED, ForceReadings, SensedInputs
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA

TORQUES = np.arange(14.0)
EXTERNAL = 0.1 * np.arange(14.0)


def stack(**changes: Any) -> Any:
    """Return what stands for a stack whose arms at home measure TORQUES and EXTERNAL [Nm]."""
    values = {"tau": TORQUES, "observes": True, **changes}
    supervisor = SimpleNamespace(
        touch=EXTERNAL,
        observer=SimpleNamespace(external=EXTERNAL),
        observes=values["observes"],
    )
    plant = SimpleNamespace(robot=DUAL_PANDA, q=DUAL_PANDA.home, tau=values["tau"])
    return SimpleNamespace(plant=plant, supervisor=supervisor)


def test_torques_are_those_of_the_motors_and_those_that_nothing_explains() -> None:
    readings = ForceReadings(stack())
    np.testing.assert_array_equal(readings.read("joint_torques"), TORQUES)
    np.testing.assert_array_equal(readings.read("external_torques"), EXTERNAL)
    assert [readings.read(name).size for name in SENSED] == [14, 14, 12, 1]
    with pytest.raises(KeyError):
        readings.read("driver")


def test_every_input_can_be_recorded() -> None:
    assert set(SENSED) <= set(SIGNALS)


def test_inputs_follow_each_other_as_the_policy_asks() -> None:
    both = stack()
    values = SensedInputs(both, {"hand_wrench": 12, "joint_torques": 14}).read()
    np.testing.assert_array_equal(values[:12], ForceReadings(both).read("hand_wrench").ravel())
    np.testing.assert_array_equal(values[12:], TORQUES)
    assert SensedInputs(both, {}).read().shape == (0,)


@pytest.mark.parametrize(
    ("inputs", "changes", "words"),
    [
        ({"effort": 14}, {}, "reads 'effort', which these arms do not sense; they sense joint_to"),
        ({"driver": 1}, {}, "reads 'driver', which these arms do not sense"),
        ({"joint_torques": 12}, {}, "12 entries of 'joint_torques'; these arms have 14"),
        (
            {"joint_torques": 14},
            {"tau": np.full(14, np.nan)},
            r"reads joint_torques, and the plant measures no joint torques \(\[nan",
        ),
        ({"joint_torques": 14}, {"tau": None}, "the plant measures no joint torques"),
        (
            {"joint_torques": 14, "hand_wrench": 12},
            {"observes": False},
            "reads hand_wrench, and no supervisor observes",
        ),
    ],
)
def test_what_is_not_sensed_is_refused_by_name(
    inputs: dict[str, int],
    changes: dict[str, Any],
    words: str,
) -> None:
    with pytest.raises(UsageError, match=words) as refused:
        SensedInputs(stack(**changes), inputs)
    assert refused.value.remedy


def test_a_plant_that_raises_measures_nothing() -> None:
    class Silent:
        robot = DUAL_PANDA

        @property
        def tau(self) -> np.ndarray:
            raise OSError("no torque sensors")

    silent = stack()
    silent.plant = Silent()
    with pytest.raises(UsageError, match=r"no joint torques \(OSError: no torque sensors\)"):
        SensedInputs(silent, {"hand_wrench": 12})
    SensedInputs(silent, {})


def test_torques_alone_need_no_supervisor() -> None:
    alone = SensedInputs(stack(observes=False), {"joint_torques": 14})
    np.testing.assert_array_equal(alone.read(), TORQUES)
