"""Compiled kernels are kept where they can be written, and a person hears where they cannot."""

import logging
import os
from pathlib import Path

import pytest
from numba import config as numba_config

from minidual.robot import kernel_cache


class Place:
    """Folders of a process; `closed` ones cannot be written."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.source = root / "package"
        self.home = root / "home"
        self.private: Path | None = root / "private"
        self.closed: set[Path] = set()
        monkeypatch.setattr(numba_config, "CACHE_DIR", "")
        monkeypatch.setenv("HOME", str(self.home))
        for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", kernel_cache._SAID):
            monkeypatch.setenv(name, "x")  # so that the test's end restores what the code sets
            monkeypatch.delenv(name)
        monkeypatch.setattr(kernel_cache, "is_writable", lambda path: path not in self.closed)
        monkeypatch.setattr(kernel_cache, "private_folder", lambda: self.private)
        (root / "private").mkdir()

    def close_all(self) -> None:
        self.closed = {self.source / "__pycache__", self.home / ".cache" / "numba"}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    return Place(tmp_path, monkeypatch)


def warnings(place: Place, caplog: pytest.LogCaptureFixture) -> list[str]:
    caplog.clear()
    with caplog.at_level(logging.WARNING, "minidual"):
        kernel_cache.choose_folder(place.source)
    return [record.getMessage() for record in caplog.records]


def test_numba_chooses_where_it_can_write(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    assert warnings(place, caplog) == []
    place.closed = {place.source / "__pycache__"}  # the user's cache folder is left
    assert warnings(place, caplog) == []
    assert numba_config.CACHE_DIR == ""


def test_a_folder_that_is_named_counts(
    place: Place,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place.close_all()
    monkeypatch.setattr(numba_config, "CACHE_DIR", "/named")
    assert warnings(place, caplog) == []
    assert numba_config.CACHE_DIR == "/named"


def test_a_read_only_environment_gets_a_folder_and_hears_of_it_once(
    place: Place,
    caplog: pytest.LogCaptureFixture,
) -> None:
    place.close_all()
    (message,) = warnings(place, caplog)
    folder = str(place.private / "numba") if place.private else ""
    assert folder in message
    assert "NUMBA_CACHE_DIR" in message
    assert folder == numba_config.CACHE_DIR
    assert os.environ["NUMBA_CACHE_DIR"] == folder
    numba_config.CACHE_DIR = ""
    assert warnings(place, caplog) == []
    assert folder == numba_config.CACHE_DIR


def test_where_nothing_can_be_written_one_process_says_so(
    place: Place,
    caplog: pytest.LogCaptureFixture,
) -> None:
    place.close_all()
    place.private = None
    (message,) = warnings(place, caplog)
    assert "compiles them again" in message
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in message
    assert warnings(place, caplog) == []
    assert numba_config.CACHE_DIR == ""
