"""Settings of methods: `methods.NAME...`, checked like all others, those of other distributions too."""

from __future__ import annotations

import pytest

from minidual.config.base import StrictModel
from minidual.config.loader import load_config
from minidual.config.root import Config
from minidual.errors import ConfigError
from minidual.trials.methods import METHODS, MethodSpec


class OtherConfig(StrictModel):
    """Settings of a method from outside."""

    pace: float = 0.5
    tries: int = 3


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> None:
    """A method of another distribution with settings, and one without."""
    row = MethodSpec(METHODS["hold"].build, "from outside", config=OtherConfig)
    rows = {"other": row, "plain": row._replace(config=None)}
    monkeypatch.setattr("minidual.config.methods._ROWS", rows)


def refusal(*overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config("smoke", overrides)
    return caught.value.message


def test_a_setting_of_ours_is_typed() -> None:
    config = load_config("smoke", ["methods.rl.steps=10"]).config
    assert config.methods.rl.steps == 10
    assert Config().methods.rl.steps > 10


@pytest.mark.usefixtures("other")
def test_a_setting_of_another_distribution_is_typed_and_has_defaults() -> None:
    config = load_config("smoke", ["methods.other.pace=0.25"]).config
    settings = config.methods.of("other", OtherConfig)
    assert settings == OtherConfig(pace=0.25)
    assert Config().methods.of("other", OtherConfig) == OtherConfig()


@pytest.mark.usefixtures("other")
def test_the_settings_survive_the_resolved_file() -> None:
    loaded = load_config("smoke", ["methods.other.pace=0.25"])
    again = type(loaded.config).model_validate(loaded.config.model_dump(mode="json"))
    assert again.methods.of("other", OtherConfig).pace == 0.25


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("methods.rl.stepz=1", "methods.rl.stepz: no such key; methods.rl has"),
        ("methods.rl.steps=0", "methods.rl.steps: must be greater than or equal to 1, is 0"),
        ("methods.other.pase=1", "methods.other.pase: no such key; methods.other has pace, tries"),
        ("methods.other.tries=x", "methods.other.tries: must be a valid integer, is the text 'x'"),
        ("methods.plain.x=1", "the method 'plain' has no settings of its own"),
        (
            "methods.nobody.x=1",
            "no method with settings of its own 'nobody'; there are other, plain, rl",
        ),
    ],
)
def test_a_wrong_setting_is_refused_with_what_was_typed(override: str, message: str) -> None:
    text = refusal(override)
    assert text.startswith(f"--set {override}: ")
    assert message in text
