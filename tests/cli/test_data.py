"""`minidual data ...` prints what it found, and its exit code says whether that is sound."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.stages.registry import STAGES, TOOLS
from tests.support import aloha_files


@pytest.fixture
def aloha(tmp_path: Path) -> Path:
    (tmp_path / "aloha").mkdir()
    for k in range(3):
        aloha_files.write(tmp_path / "aloha" / f"episode_{k}.hdf5", seed=k)
    return tmp_path / "aloha"


def typed(*words: object) -> int:
    return run_command_line(["data", *map(str, words)], STAGES, TOOLS)


def test_sound_data_passes_and_faulty_data_fails(
    aloha: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert typed("check", aloha) == 0
    assert "ALOHA HDF5 episodes: 3 episodes, 0 with faults" in capsys.readouterr().out
    (aloha / "episode_3.hdf5").write_bytes(b"nothing")
    assert typed("check", aloha, "--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert [fault["name"] for fault in document["faults"]] == ["file_corrupt"]
    assert document["faults"][0]["episode"] == "episode_3.hdf5"
    (aloha / "meta").mkdir()
    (aloha / "meta" / "info.json").write_text("{}")
    assert typed("check", aloha) == 1
    assert "dataset_unreadable" in capsys.readouterr().out


def test_numbers_are_printed_and_written(
    aloha: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = tmp_path / "episodes.csv"
    assert typed("stats", aloha, "--csv", table) == 0
    text = capsys.readouterr().out
    assert "3 episodes, 90 ticks" in text
    assert "left_waist" in text
    assert len(table.read_text().splitlines()) == 4
    assert typed("stats", aloha, "--json") == 0
    assert json.loads(capsys.readouterr().out)["ticks_n"] == 90


def test_a_page_shows_the_episodes_that_were_named(
    aloha: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "page.html"
    assert typed("show", aloha, "--episodes", "0,2", "--out", page) == 0
    assert "2 of 3 episodes" in capsys.readouterr().out
    assert page.read_text().count("<section>") == 2
    assert typed("show", aloha, "--episodes", "0-3", "--out", page) == 2
    assert "there are episodes 0 to 2" in capsys.readouterr().err
    assert typed("show", aloha, "--episodes", "first") == 2


def test_parts_are_folders_of_files(
    aloha: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "parts"
    assert typed("split", aloha, "--out", out, "--parts", "train=0.67,test=0.33") == 0
    assert "train: 2 episodes" in capsys.readouterr().out
    files = sorted(path.name for path in out.rglob("*.hdf5"))
    assert files == ["episode_0.hdf5", "episode_1.hdf5", "episode_2.hdf5"]
    assert typed("check", out / "test") == 0
    assert typed("split", aloha, "--out", out) == 2


def test_merging_nothing_is_wrong_usage(tmp_path: Path) -> None:
    assert typed("merge", tmp_path / "nowhere", "--out", tmp_path / "new") == 2
    assert typed("check") == 2
