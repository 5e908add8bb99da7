"""A film shows the methods of one start side by side, in step, with what they did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.show.figures.film_caption import Caption, bar_height, captioned
from minidual.show.figures.side_by_side import FPS, Take, film_takes, pane_size, take
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from tests.support.late import late

av = late("av")


@pytest.fixture(scope="module")
def shown() -> Take:
    task = make_task(Config(task="rod_carry"))
    inputs = MethodInputs(task.config, task.config.seed)
    shown = take("hold", inputs, task.trial(0, "film", 0))
    return replace(shown, moments=shown.moments[:10])


def test_a_take_has_a_moment_for_each_frame(shown: Take) -> None:
    times_s = [moment.time_s for moment in shown.moments]
    np.testing.assert_allclose(np.diff(times_s), 1.0 / FPS, atol=2e-3)
    assert shown.at(5 / FPS) is shown.moments[5]
    assert shown.at(99.0) is shown.moments[-1]
    assert shown.end_s == pytest.approx(9 / FPS)


def test_the_bar_tells_running_success_and_failure_apart(shown: Take) -> None:
    won = replace(shown, result=replace(shown.result, success=True, duration_s=1.0))
    captions = [shown.caption(0.1), shown.caption(9.0), won.caption(9.0)]
    assert [caption.success for caption in captions] == [None, False, True]
    assert len({caption.colour for caption in captions}) == 3
    black = np.zeros((180, 320, 3), np.uint8)
    running, failed, _ = (captioned(black, caption) for caption in captions)
    assert running.shape == (180 + bar_height(320), 320, 3)
    assert tuple(running[-1, 0]) == captions[0].colour
    assert tuple(failed[0, 0]) == captions[1].colour, "a failure has a frame"
    assert tuple(running[0, 0]) == (0, 0, 0)


def test_captions_carry_time_phase_forces_and_what_failed(shown: Take) -> None:
    moment = shown.moments[6]._replace(phase="lift", pinch_n=(41.2, 39.8), squeeze_n=40.4)
    moments = [*shown.moments[:6], moment, *shown.moments[7:]]
    running = replace(shown, moments=moments).caption(0.5)
    assert running.title == "hold"
    assert running.clock == "0.50 s"
    assert running.text == "lift"
    assert running.detail == "pinch 41 N, 40 N   squeeze 40 N"
    failed = shown.caption(99.0)
    assert f"{shown.result.failed_at_s:.2f} s" in failed.text
    assert failed.detail == shown.result.reason
    won = replace(shown, result=replace(shown.result, success=True, duration_s=6.83))
    assert won.caption(99.0).text == "success in 6.83 s"


def test_a_long_reason_is_cut_after_two_lines() -> None:
    black = np.zeros((180, 320, 3), np.uint8)
    short = captioned(black, Caption("a", "1 s", "text", "why", success=False))
    long = captioned(black, Caption("a", "1 s", "text", "why " * 200, success=False))
    assert short.shape == long.shape
    assert not np.array_equal(short, long)
    colour = np.array(Caption("", "", "", "", success=False).colour)
    assert (long[-2:] == colour).all(), "nothing is cut by the edge"


def test_panes_stand_side_by_side_until_the_longest_has_ended(
    shown: Take,
    tmp_path: Path,
) -> None:
    short = replace(shown, moments=shown.moments[:4])
    path = tmp_path / "film.mp4"
    frames_n = film_takes([shown, short], path)
    assert frames_n == 9 + 2 * FPS
    with av.open(path) as film:
        (stream,) = film.streams.video
        assert stream.codec_context.width == 2 * pane_size(2)[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == frames_n
    left, right = np.split(frames[0].astype(float), 2, axis=1)
    middle = slice(40, pane_size(2)[1] - 40)
    assert np.abs(left[middle] - right[middle]).mean() < 3.0
