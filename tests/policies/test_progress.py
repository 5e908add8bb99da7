"""Progress of a training: an interrupted one goes on to the same weights, any other file is set aside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from minidual import emergency
from minidual.config.learning import TrainConfig
from minidual.policies.demonstrations import Demonstrations
from tests.support.late import late
from tests.support.training_samples import SMALL, same, tiny, train, weights

torch = late("torch")
pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    return tiny()


@pytest.mark.parametrize("stop_at", [2, 3])
def test_an_interrupted_training_goes_on_to_the_same_weights(
    demos: Demonstrations,
    tmp_path: Path,
    stop_at: int,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    whole = train(demos, config, 5, tmp_path / "whole")
    done = 0

    def interrupt(steps: int, _loss: float) -> None:
        nonlocal done
        done += steps
        if done == stop_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress", advance=interrupt)
    assert not (tmp_path / "cut").exists()
    steps_reported: list[int] = []
    resumed = train(
        demos,
        config,
        5,
        tmp_path / "cut",
        progress=tmp_path / "progress",
        advance=lambda steps, _: steps_reported.append(steps),
    )
    assert resumed.resumed_from_step == steps_reported[0] == stop_at
    assert sum(steps_reported) == whole.steps
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))
    assert resumed.curve == whole.curve


def interrupt(_steps: int, _loss: float) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("change", ["seed", "config", "data"])
def test_progress_of_another_training_is_not_used(
    demos: Demonstrations,
    tmp_path: Path,
    change: str,
) -> None:
    config = TrainConfig(**SMALL)
    seed = 5
    with pytest.raises(KeyboardInterrupt):
        train(
            demos,
            config,
            seed,
            tmp_path / "cut",
            progress=tmp_path / "progress",
            advance=interrupt,
        )
    if change == "seed":
        seed = 6
    elif change == "config":
        config = TrainConfig(**{**SMALL, "approach_weight": 1.0})
    else:
        demos = tiny(seed=1)
    before = (tmp_path / "progress").read_bytes()
    result = train(demos, config, seed, tmp_path / "cut", progress=tmp_path / "progress")
    assert result.resumed_from_step == 0
    assert result.set_aside is not None
    assert result.set_aside.parent == tmp_path / "set-aside"
    assert result.set_aside.name.startswith("train-act.other-progress-")
    assert result.set_aside.read_bytes() == before


def test_an_interrupted_training_says_where_the_one_before_is_and_that_goes_on(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    """A second Ctrl-C does not replace the progress of the training before."""
    config = TrainConfig(**SMALL)
    progress = tmp_path / "progress"
    train(demos, config, 5, tmp_path / "whole")
    for learning_rate in (config.learning_rate, 0.1):
        changed = TrainConfig(**{**SMALL, "learning_rate": learning_rate})
        with pytest.raises(KeyboardInterrupt) as caught:
            train(demos, changed, 5, tmp_path / "cut", progress=progress, advance=interrupt)
    (moved,) = (tmp_path / "set-aside").iterdir()
    assert str(caught.value) == f"interrupted; an earlier training's progress is in {moved}"
    moved.replace(progress)
    assert train(demos, config, 5, tmp_path / "cut", progress=progress).resumed_from_step == 1
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def test_settings_without_influence_on_the_weights_do_not_end_a_training(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    free = {
        "seeds_n": 3,
        "log_every_steps": 1,
        "validate_every_steps": 1,
        "checkpoint_every_steps": 1,
    }
    changed = TrainConfig(
        **{**SMALL, **free, "time_limit_s": 900.0, "loss_ratio_max": 0.9},
        dropout=0.1,
    )
    train(demos, config, 5, tmp_path / "whole")
    train(demos, changed, 5, tmp_path / "changed")
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "changed"))
    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress", advance=interrupt)
    result = train(demos, changed, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert (result.resumed_from_step, result.set_aside) == (1, None)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def test_the_emergency_stop_ends_a_training_which_goes_on_later(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**SMALL)
    whole = train(demos, config, 5, tmp_path / "whole")
    try:
        with pytest.raises(emergency.EmergencyStop):
            train(
                demos,
                config,
                5,
                tmp_path / "cut",
                progress=tmp_path / "progress",
                advance=lambda *_: emergency.press("test"),
            )
    finally:
        emergency.release()
    assert not (tmp_path / "cut").exists()
    resumed = train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert (resumed.resumed_from_step, resumed.curve) == (1, whole.curve)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def at_call(count: int, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, interrupted after its `count`-th call."""
    calls = iter(range(count, -1, -1))

    def interrupted(*args: Any, **options: Any) -> Any:
        result = function(*args, **options)
        if next(calls, 0) == 1:
            raise KeyboardInterrupt
        return result

    return interrupted


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("predict_action_chunk", 1),  # validation after step 2: the average is in the policy
        ("LossRow", 1),  # step 2 is not in the curve yet
        ("step", 3),  # step 3 is applied and not counted
        ("get_ema_multi_avg_fn", 3),
    ],
)
def test_an_interruption_within_a_step_leaves_the_progress_of_a_whole_one(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    count: int,
) -> None:
    """Weights, average, optimiser and curve in the progress belong to the same step."""
    from minidual.policies import optimiser
    from minidual.policies import train as loop
    from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy

    config = TrainConfig(**SMALL, checkpoint_every_steps=2)
    whole = train(demos, config, 5, tmp_path / "whole")
    place = {
        "predict_action_chunk": SpatialActPolicy,
        "LossRow": loop,
        "step": torch.optim.AdamW,
        "get_ema_multi_avg_fn": optimiser,
    }[name]
    with monkeypatch.context() as patch:
        patch.setattr(place, name, at_call(count, getattr(place, name)))
        with pytest.raises(KeyboardInterrupt):
            train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    resumed = train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert resumed.resumed_from_step == 2
    assert resumed.curve == whole.curve
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def other_keys(path: Path) -> None:
    torch.save({"fingerprint": "?"}, path)


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    "damage",
    [
        truncated,
        other_keys,
        flipped,
        a_folder,
        lambda path: path.write_bytes(b""),
        lambda p: p.write_text("\xff"),
    ],
)
def test_damaged_progress_is_set_aside_and_training_starts_anew(
    demos: Demonstrations,
    tmp_path: Path,
    damage: Callable[[Path], Any],
) -> None:
    config = TrainConfig(**SMALL)
    folder = tmp_path / ".train-act.progress"
    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=folder, advance=interrupt)
    damage(folder)
    result = train(demos, config, 5, tmp_path / "cut", progress=folder)
    assert (result.resumed_from_step, result.steps) == (0, config.steps)
    assert result.set_aside is not None
    assert result.set_aside.parent == tmp_path / "set-aside"
    assert result.set_aside.name.startswith("train-act.damaged-progress-")
    assert result.set_aside.exists()
