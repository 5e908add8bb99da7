"""`data augment` keeps what passes, sets the rest apart with reasons, and makes a dataset."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from minidual.cli.app import run_command_line
from minidual.config.root import changed
from minidual.demos import recording
from minidual.demos.episode import episode_paths
from minidual.demos.lerobot_reader import read_dataset
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.gate.stage import ToolContext
from minidual.stages import data_augment as module
from minidual.stages.data_augment import RECORD, augment_lines, augment_record, data_augment
from minidual.stages.registry import STAGES, TOOLS
from tests.support.carried_demo import write_carry
from tests.support.recording_toys import ToyRig
from tests.support.tool_contexts import tool_context


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One demonstration; each attempt is a toy, of which every fourth fails."""
    monkeypatch.setattr(recording, "Rig", ToyRig)
    write_carry(tmp_path / "sources")
    return tmp_path / "sources"


def context(
    tmp_path: Path,
    sources: Path,
    task: str = "rod_carry",
    episodes: int = 4,
    **options: Any,
) -> ToolContext:
    made = tool_context(tmp_path, "augmented", task, path=str(sources), **options)
    config = changed(made.config, {"teleop.episodes_n": episodes})
    return ToolContext(
        config=config,
        seed=made.seed,
        profile=made.profile,
        options=made.options,
        run_folder=made.run_folder,
        name=made.name,
    )


@pytest.mark.torch
def test_what_passes_is_kept_and_the_rest_is_counted_by_reason(
    tmp_path: Path,
    sources: Path,
) -> None:
    result = data_augment(context(tmp_path, sources))
    folder = tmp_path / "run" / "augmented"
    record = json.loads((folder / RECORD).read_text())
    assert (record["kept"], record["attempts"], record["sources"]) == (4, 5, 1)
    assert sum(record["rejected"].values()) == 1
    assert len(episode_paths(folder / "episodes")) == 4
    assert len(episode_paths(folder / "rejected")) == 1
    assert len(read_dataset(folder / "lerobot").starts) == 4
    assert any(line.startswith("accepted: 4 of 5 attempts, 80 %") for line in result.lines)
    data_augment(context(tmp_path, sources, episodes=2))
    assert len(read_dataset(folder / "lerobot").starts) == 2
    kept = list((tmp_path / "run" / "set-aside").iterdir())
    assert len(kept) == 1
    assert len(episode_paths(kept[0] / "episodes")) == 4


def test_when_nothing_passes_the_commonest_reason_is_named(
    tmp_path: Path,
    sources: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limited = context(tmp_path, sources, episodes=1)
    config = changed(limited.config, {"teleop.jerk_max_rad_s3": 1e-6})
    strict = ToolContext(
        config=config,
        seed=limited.seed,
        profile="standard",
        options=limited.options,
        run_folder=limited.run_folder,
        name=limited.name,
    )
    with pytest.raises(NothingEvaluatedError, match=r"none of 4 .*RMS jerk # rad/s"):
        data_augment(strict)
    assert json.loads((strict.folder / RECORD).read_text())["kept"] == 0


def test_what_cannot_be_moved_is_refused_before_anything_is_written(
    tmp_path: Path,
    sources: Path,
) -> None:
    with pytest.raises(UsageError, match=r"the task 'sort' .*pot_lift, rod_carry can be moved"):
        data_augment(context(tmp_path, sources, task="sort"))
    with pytest.raises(UsageError, match="--attempts is 3; 4 episodes"):
        data_augment(context(tmp_path, sources, attempts=3))
    with pytest.raises(UsageError, match="no condition 'rain'"):
        data_augment(context(tmp_path, sources, conditions="rain"))
    with pytest.raises(UsageError, match="no HDF5 episodes"):
        data_augment(context(tmp_path, tmp_path / "nowhere"))
    assert not (tmp_path / "run").exists()


def test_the_count_of_demonstrations_reaches_the_command(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["data", "augment", str(tmp_path), "--runs-dir", str(tmp_path / "runs")]
    assert run_command_line([*words, "--episodes", "0"], STAGES, TOOLS) == 2
    assert "teleop.episodes_n" in capsys.readouterr().err
    assert run_command_line(words, STAGES, TOOLS) == 2
    assert "no HDF5 episodes" in capsys.readouterr().err


def test_reasons_are_counted_without_their_numbers() -> None:
    assert module._short("grip lost (left pinches 1.2 N, needs > 2 N), at 3.10 s") == "grip lost"
    assert module._short("RMS jerk 240 rad/s^3, limit 200") == "RMS jerk # rad/s^#, limit #"
    record = augment_record([], 3, ["one is no carry"])
    assert record["sources_refused"] == ["one is no carry"]
    record |= {"kept": 1, "attempts": 2, "rejected": {"grip lost": 1}}
    assert augment_lines(record, Path("new"))[-1].endswith("train-act --dataset new")
