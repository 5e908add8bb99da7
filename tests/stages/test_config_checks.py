"""Settings that contradict each other are refused before the first stage."""

from __future__ import annotations

import pytest

from minidual.config.root import Config
from minidual.errors import ConfigError, EnvironmentMissingError
from minidual.policies import kinds
from minidual.stages.config_checks import check_leader, check_policy


def test_a_recording_holds_what_its_policy_is_to_read() -> None:
    settings = {"train": {"inputs": ["hand_wrench"]}, "teleop": {"signals": ["driver"]}}
    with pytest.raises(
        ConfigError, match=r"asks for hand_wrench; .*teleop\.signals\) are driver"
    ) as no:
        check_leader(Config.model_validate(settings))
    check_policy(Config.model_validate(settings))  # train-act --dataset may read another recording
    assert "teleop.signals=[driver, hand_wrench]" in str(no.value.remedy)
    settings["teleop"]["signals"] = ["hand_wrench"]
    check_leader(Config.model_validate(settings))


def test_a_policy_whose_library_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    config = Config.model_validate({"train": {"policy": "diffusion"}})
    monkeypatch.setattr(kinds, "find_spec", lambda name: None)
    with pytest.raises(EnvironmentMissingError, match="needs the library 'diffusers'") as missing:
        check_policy(config)
    assert missing.value.remedy == "pip install 'minidual[diffusion]'"
    monkeypatch.setattr(kinds, "find_spec", lambda name: object())
    check_policy(config)
