"""The training loop: same seed same weights, clear errors, limits."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from pydantic import ValidationError

from minidual.config.learning import TrainConfig
from minidual.errors import UsageError
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import TrainResult, write_loss_csv
from minidual.show.figures.training import draw_loss
from tests.support.late import late
from tests.support.training_samples import SMALL, same, tiny, train, weights

torch = late("torch")
pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    return tiny()


def test_the_same_seed_gives_the_same_weights_and_another_seed_does_not(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    for outside, (name, seed) in enumerate((("a", 5), ("b", 5), ("c", 6))):
        torch.manual_seed(outside)  # the generator outside must not matter
        train(demos, config, seed, tmp_path / name)
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))
    assert not same(weights(tmp_path / "a"), weights(tmp_path / "c"))


def test_training_leaves_the_torch_generator_and_threads_alone(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    threads = torch.get_num_threads()
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    assert torch.equal(torch.rand(3), expected)
    assert torch.get_num_threads() == threads


def test_a_loss_that_is_not_finite_stops_with_the_step_and_the_learning_rate(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy

    forward = SpatialActPolicy.forward
    calls = 0

    def diverge(
        self: SpatialActPolicy,
        batch: dict[str, torch.Tensor],
    ) -> tuple[torch.Tensor, dict[str, float]]:
        nonlocal calls
        calls += 1
        loss, parts = forward(self, batch)
        return (loss * torch.inf if calls == 3 else loss), parts

    monkeypatch.setattr(SpatialActPolicy, "forward", diverge)
    with pytest.raises(UsageError, match="loss became inf at step 2") as caught:
        train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    assert "train.learning_rate=" in str(caught.value.remedy)
    assert not (tmp_path / "a").exists()


def test_the_time_limit_cuts_training_and_says_so(demos: Demonstrations, tmp_path: Path) -> None:
    result = train(
        demos,
        TrainConfig(**{**SMALL, "steps": 400, "time_limit_s": 0.05}),
        0,
        tmp_path / "a",
    )
    assert result.stopped_by == "time limit"
    assert 0 < result.steps < 400 == result.steps_asked


def test_a_budget_counts_the_steps_that_fit_and_trains_exactly_those(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The weights are those of that many steps: timing a copy changes nothing."""
    from minidual.policies.train import _Loop

    timed = _Loop.timed_step_s
    times_s: list[float] = []

    def constant(self: object) -> float:
        times_s.append(timed(self))
        return 1e4

    monkeypatch.setattr(_Loop, "timed_step_s", constant)
    budget = TrainConfig(**SMALL, budget_s=4.5e4)
    result = train(demos, budget, 0, tmp_path / "a")
    assert (result.steps, result.steps_asked) == (4, 4)
    assert times_s[0] > 0.0
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "b")
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))


def test_an_interrupted_budget_keeps_the_steps_that_it_began_with(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from minidual.policies.train import _Loop

    budget = TrainConfig(**SMALL, budget_s=4.5e4)

    def interrupt(_steps: int, _loss: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(_Loop, "timed_step_s", lambda self: 1e4)
    place = tmp_path / "progress"
    with pytest.raises(KeyboardInterrupt):
        train(demos, budget, 0, tmp_path / "a", progress=place, advance=interrupt)
    monkeypatch.setattr(_Loop, "timed_step_s", lambda self: 1e3)
    result = train(demos, budget, 0, tmp_path / "a", progress=place)
    assert (result.resumed_from_step, result.steps, result.set_aside) == (1, 4, None)


def test_a_budget_of_no_time_trains_one_step(demos: Demonstrations, tmp_path: Path) -> None:
    result = train(demos, TrainConfig(**SMALL, budget_s=1e-3), 0, tmp_path / "a")
    assert (result.steps, result.steps_asked, result.stopped_by) == (1, 1, "steps")


def test_the_configured_learning_rate_is_what_the_curve_shows(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**{**SMALL, "steps": 40, "warmup_fraction": 0.1})
    rates = [row.learning_rate for row in train(demos, config, 0, tmp_path / "a").curve]
    assert max(rates) == pytest.approx(config.learning_rate, rel=0.01)
    assert rates[-1] < 0.02 * config.learning_rate
    assert rates.index(max(rates)) <= 2


def test_records_hold_the_curve(demos: Demonstrations, tmp_path: Path) -> None:
    result: TrainResult = train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    write_loss_csv(result.curve, tmp_path / "loss.csv")
    lines = (tmp_path / "loss.csv").read_text().splitlines()
    assert lines[0].startswith("step,loss,l1,keyframe")
    assert [line.split(",")[0] for line in lines[1:]] == ["2", "4"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_loss(result, tmp_path / "loss.svg")
    assert ">training, action L1</text>" in (tmp_path / "loss.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "bad",
    [
        {"dim_model": 64, "heads": 7},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"policy": ""},
        {"budget_s": 0.0},
        {"inputs": ["hand_wrench", "hand_wrench"]},
        {"steps": 0},
        {"unknown": 1},
    ],
)
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TrainConfig(**bad)  # type: ignore[arg-type]


def test_what_reads_the_pictures_has_its_own_learning_rate(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    for rate in (1e-3, 1e-2):
        train(
            demos,
            TrainConfig(**(SMALL | {"steps": 1, "backbone_learning_rate": rate})),
            0,
            tmp_path / f"{rate}",
        )
    slow, fast = (weights(tmp_path / f"{rate}") for rate in (1e-3, 1e-2))
    differ = {name for name, values in slow.items() if not torch.equal(values, fast[name])}
    assert differ
    assert all(name.startswith("model.backbone.") for name in differ)
