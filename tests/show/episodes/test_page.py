"""The page of demonstrations is one offline file; rerun gets the same."""

from __future__ import annotations

import base64
import dataclasses
import io
import re
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from minidual.demos.data.check import check_data
from minidual.demos.data.places import open_data
from minidual.errors import EnvironmentMissingError
from minidual.robot.pair import DUAL_PANDA
from minidual.show.episodes.page import film_uri, plots, write_page
from minidual.show.episodes.rerun_file import write_rerun
from tests.support import aloha_files


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "aloha").mkdir()
    for k in range(2):
        aloha_files.write(tmp_path / "aloha" / f"episode_{k}.hdf5", seed=k)
    return tmp_path / "aloha"


def test_the_page_holds_films_signals_and_faults_and_needs_no_network(folder: Path) -> None:
    import h5py

    with h5py.File(folder / "episode_1.hdf5", "r+") as file:
        file["observations/images/cam_high"][5] = 0
    source = open_data(str(folder), DUAL_PANDA)
    page = folder / "page.html"
    write_page(source, [0, 1], check_data(source), ["two <episodes>"], page)
    text = page.read_text()
    assert text.count("data:video/mp4;base64,") == 4
    assert text.count("<canvas data-plot=") == 2 * 4, "two of states, two of efforts"
    assert "two &lt;episodes&gt;" in text
    assert "Faults: 1" in text
    assert "images_black: camera &#39;cam_high&#39;" in text
    assert re.findall(r"""(?:src|href)=["'](?!data:)""", text) == []
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", text)
    write_page(source, [1], [], [], page)
    assert page.read_text().count("<section>") == 1


def test_a_film_plays_everywhere_and_has_every_picture(folder: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (7, 9, 15, 3), np.uint8)
    content = base64.b64decode(film_uri(images, 20.0).partition("base64,")[2])
    with av.open(io.BytesIO(content)) as film:
        stream = film.streams.video[0]
        assert (stream.pix_fmt, stream.height, stream.width) == ("yuv420p", 10, 16)
        assert sum(1 for _ in film.decode(video=0)) == 7


def test_a_plot_shows_at_most_eight_signals_and_the_command_over_the_state(folder: Path) -> None:
    episode = next(iter(open_data(str(folder), DUAL_PANDA).episodes())).episode
    assert episode is not None
    drawn = plots(episode)
    assert [len(plot["lines"]) for plot in drawn] == [7, 7, 7, 7]
    many = dataclasses.replace(
        episode,
        state=np.hstack([episode.state] * 2),
        state_names=tuple(f"s{k}" for k in range(28)),
        effort=None,
    )
    assert [len(plot["lines"]) for plot in plots(many)] == [8, 8, 8, 4, 7, 7]
    first = drawn[0]["lines"][0]
    np.testing.assert_allclose(first["y"], episode.state[:, 0], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(first["command"], episode.action[:, 0], rtol=1e-4, atol=1e-9)


def test_rerun_gets_every_signal_and_picture(folder: Path) -> None:
    pytest.importorskip("rerun")
    source = open_data(str(folder), DUAL_PANDA)
    write_rerun(source, [0], folder / "one.rrd")
    write_rerun(source, [0, 1], folder / "two.rrd")
    one, two = ((folder / name).stat().st_size for name in ("one.rrd", "two.rrd"))
    assert (folder / "one.rrd").read_bytes()[:4] == b"RRF2"
    assert 1000 < one < two


def test_without_rerun_the_command_says_what_to_install(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    source = open_data(str(folder), DUAL_PANDA)
    with pytest.raises(EnvironmentMissingError, match="needs the library rerun-sdk"):
        write_rerun(source, [0], folder / "one.rrd")
