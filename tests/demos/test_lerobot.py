"""The LeRobot dataset holds what was recorded, is whole or absent, and says so when it is not."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

from minidual.config.leading import ReplayConfig
from minidual.config.scene import SceneConfig
from minidual.demos import lerobot_reader
from minidual.demos.episode import read_episode
from minidual.demos.leaders.replay import ReplayLeader
from minidual.demos.lerobot_reader import LeRobotTables, read_dataset
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support import data_samples
from tests.support.carry_trials import sample_trial
from tests.support.late import late

adapter = late("minidual.demos.lerobot_adapter")
pytestmark = pytest.mark.torch

HIGH = "observation.images.cam_high"
TICKS = (40, 33)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path], LeRobotTables]:
    folder = tmp_path_factory.mktemp("lerobot")
    sources = [
        data_samples.write(
            folder / f"episode_{i:06d}.hdf5",
            data_samples.arrays(ticks, seed=i, size=(96, 128), cameras=("high", "left")),
            seed=100 + i,
        )
        for i, ticks in enumerate(TICKS)
    ]
    tables = adapter.convert(sources, folder / "dataset", DUAL_PANDA)
    return folder / "dataset", sources, tables


@pytest.fixture
def copy(made: tuple[Path, list[Path], LeRobotTables], tmp_path: Path) -> tuple[Path, list[Path]]:
    shutil.copytree(made[0], tmp_path / "dataset")
    return tmp_path / "dataset", made[1]


def test_an_episode_is_written_before_the_next_is_asked_for(made: tuple, tmp_path: Path) -> None:
    _, sources, data = made
    films = []

    def recorded() -> Iterator[Path]:
        for source in sources:
            yield source
            films.append(len(list(tmp_path.glob(".dataset.*.partial/videos/**/*.mp4"))))

    tables = adapter.convert(recorded(), tmp_path / "dataset", DUAL_PANDA)
    assert films == [2, 2], "one film of each camera, while the second episode is not recorded yet"
    assert len(tables) == len(data)


def test_the_tables_count_rows_and_name_what_is_inside(made: tuple) -> None:
    root, sources, data = made
    assert (data.root, len(data.starts), len(data)) == (root, 2, sum(TICKS))
    assert (data.fps, data.cameras) == (50.0, {"high": (96, 128), "left": (96, 128)})
    assert 0.0 < adapter.verify_dataset(root, sources, DUAL_PANDA) < 3.0
    assert sorted(path.name for path in root.iterdir()) == ["data", "meta", "videos"]
    assert [path.name for path in root.parent.iterdir() if path.name.startswith(".")] == []


def test_statistics_of_sampled_pictures_are_those_of_all_pixels_and_lerobot_is_left_as_it_was(
    made: tuple,
) -> None:
    root, sources, _ = made
    table = pq.read_table(next((root / "meta" / "episodes").glob("*/*.parquet"))).to_pydict()
    for stored, source in zip(table[f"stats/{HIGH}/mean"], sources, strict=True):
        recorded = read_episode(source).images["high"].mean(axis=(0, 1, 2)) / 255.0
        assert np.ravel(stored) == pytest.approx(recorded, abs=0.005), "of 0.03 that may differ"
    picture = np.zeros((3, 96, 128), np.uint8)
    assert adapter.compute_stats.auto_downsample_height_width(picture).shape == picture.shape


def test_memory_holds_what_was_recorded(made: tuple) -> None:
    root, sources, _ = made
    data = read_dataset(root)
    assert data.state.dtype == data.action.dtype == np.float32
    assert data.names == adapter.state_names(DUAL_PANDA)
    assert data.names[:1] + data.names[7:8] + data.names[14:] == (
        "left_panda_joint1",
        "right_panda_joint1",
        "left_gripper",
        "right_gripper",
    )
    images = data.images("high")
    assert images.shape == (sum(TICKS), 96, 128, 3)
    for index, path in enumerate(sources):
        episode = read_episode(path)
        rows = slice(data.starts[index], data.stops[index])
        np.testing.assert_array_equal(data.state[rows, :14], episode.qpos.astype(np.float32))
        np.testing.assert_array_equal(data.state[rows, 14:], episode.gripper.astype(np.float32))
        np.testing.assert_array_equal(data.action[rows, :14], episode.action.astype(np.float32))
        np.testing.assert_array_equal(
            data.action[rows, 14:],
            episode.action_gripper.astype(np.float32),
        )
        np.testing.assert_array_equal(data.frame_index[rows], np.arange(TICKS[index]))
        assert set(data.episode_index[rows]) == {index}
        # The right picture at the right tick: each frame is nearest to its own recording's frame.
        shown = images[rows].astype(float)
        for k in (0, TICKS[index] // 2, TICKS[index] - 1):
            distance = np.abs(shown[k] - episode.images["high"]).mean(axis=(1, 2, 3))
            assert int(np.argmin(distance)) == k
            assert distance[k] < 2.0


def test_images_for_which_memory_is_short_are_mapped_from_a_file_without_a_name(
    made: tuple,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = read_dataset(made[0])
    kept = data.images("high", folder=tmp_path)
    assert kept.base is None, "there is memory enough"
    monkeypatch.setattr(lerobot_reader, "MEMORY_SHARE", 0.0)
    mapped = data.images("high", folder=tmp_path)
    assert isinstance(mapped.base, np.memmap)
    assert list(tmp_path.iterdir()) == []
    np.testing.assert_array_equal(mapped, kept)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(EnvironmentMissingError, match="no space left on the disk of"):
        data.images("high", folder=tmp_path)


def test_lerobot_itself_opens_it_and_agrees(made: tuple) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root, _, _ = made
    dataset = LeRobotDataset("local/dataset", root=root, video_backend="pyav")
    data = read_dataset(root)
    images = data.images("high")
    assert (len(dataset), dataset.meta.total_episodes, dataset.fps) == (sum(TICKS), 2, 50)
    for row in (0, TICKS[0] - 1, TICKS[0], sum(TICKS) - 1):
        item = dataset[row]
        np.testing.assert_array_equal(item["observation.state"].numpy(), data.state[row])
        np.testing.assert_array_equal(item["action"].numpy(), data.action[row])
        assert float(item["timestamp"]) == pytest.approx(data.frame_index[row] / 50)
        assert item["task"] == "carry the rod"
        picture = item[HIGH].numpy().transpose(1, 2, 0) * 255
        assert np.abs(picture - images[row]).max() <= 1.0
    stats = dataset.meta.stats["observation.state"]
    np.testing.assert_allclose(stats["mean"], data.state.mean(axis=0), atol=1e-4)


def test_an_unknown_camera_is_named(made: tuple) -> None:
    with pytest.raises(UsageError, match=r"no camera 'top'; there are high, left"):
        read_dataset(made[0]).images("top")


def test_the_sources_are_written_beside_the_data(made: tuple) -> None:
    records = json.loads((made[0] / adapter.SOURCES_FILE).read_text())["episodes"]
    assert [record["seed"] for record in records] == [100, 101]
    assert [record["ticks"] for record in records] == list(TICKS)


def test_a_lost_video_frame_is_noticed(copy: tuple[Path, list[Path]]) -> None:
    import av

    root, sources = copy
    video = next((root / "videos" / HIGH).rglob("*.mp4"))
    with av.open(str(video)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    with av.open(str(video), "w") as container:
        stream = container.add_stream("h264", 50)
        stream.height, stream.width = frames[0].shape[:2]
        for frame in frames[:-1]:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    with pytest.raises(DataError, match="holds 72 frames; the table has 73 rows"):
        adapter.verify_dataset(root, sources, DUAL_PANDA)


def test_a_changed_state_is_noticed(copy: tuple[Path, list[Path]]) -> None:
    root, sources = copy
    path = next((root / "data").rglob("*.parquet"))
    table = pq.read_table(path)
    states = table["observation.state"].to_pylist()
    states[3][5] += 1e-4
    column = table.schema.get_field_index("observation.state")
    import pyarrow as pa

    pq.write_table(
        table.set_column(
            column,
            "observation.state",
            pa.array(states, type=table.schema.field(column).type),
        ),
        path,
    )
    with pytest.raises(DataError, match=r"episode 0 .*observation\.state differs"):
        adapter.verify_dataset(root, sources, DUAL_PANDA)


def test_swapped_cameras_and_other_recordings_are_noticed(copy: tuple[Path, list[Path]]) -> None:
    root, sources = copy
    with pytest.raises(DataError, match="episode 0"):
        adapter.verify_dataset(root, sources[::-1], DUAL_PANDA)
    with pytest.raises(DataError, match="2 episodes; 1 were recorded"):
        adapter.verify_dataset(root, sources[:1], DUAL_PANDA)
    high, left = (root / "videos" / key for key in (HIGH, "observation.images.cam_left"))
    high.rename(root / "videos" / "aside")
    left.rename(high)
    (root / "videos" / "aside").rename(left)
    with pytest.raises(DataError, match="camera 'high' at tick 0 differs"):
        adapter.verify_dataset(root, sources, DUAL_PANDA)


@pytest.mark.parametrize(
    "victim",
    ["data/**/*.parquet", "meta/episodes/**/*.parquet", "videos/**/*.mp4", "meta/info.json"],
)
def test_a_truncated_dataset_file_is_named(copy: tuple[Path, list[Path]], victim: str) -> None:
    root, _ = copy
    path = next(root.glob(victim))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DataError, match=path.name):
        read_dataset(root).images("high")


def test_a_wrong_count_in_info_is_noticed(copy: tuple[Path, list[Path]]) -> None:
    root, _ = copy
    info = json.loads((root / "meta/info.json").read_text())
    info["total_frames"] += 1
    (root / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(DataError, match="declares 74 frames"):
        read_dataset(root)
    with pytest.raises(DataError, match="no LeRobot dataset"):
        read_dataset(root / "nowhere")


def test_what_cannot_be_converted_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    good = data_samples.write(tmp_path / "a.hdf5", data_samples.arrays(6))
    slow = data_samples.write(tmp_path / "b.hdf5", data_samples.arrays(6, fps=25.0), fps=25.0)
    odd = data_samples.write(tmp_path / "c.hdf5", data_samples.arrays(6, size=(32, 32)))
    broken = tmp_path / "d.hdf5"
    broken.write_bytes(good.read_bytes()[:3000])
    one = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(6, cameras=["high"]))
    for paths, kind, words in (
        ([], UsageError, "no episodes"),
        ([good, slow], DataError, "25 Hz"),
        ([good, broken], DataError, "d.hdf5"),
        ([good, one], DataError, "no camera left, right"),
        ([good, odd], DataError, "c.hdf5: camera 'high'"),
    ):
        with pytest.raises(kind, match=words):
            adapter.convert(paths, tmp_path / "out", DUAL_PANDA)
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            f"{name}.hdf5" for name in "abcde"
        ]


def test_an_existing_dataset_is_kept(tmp_path: Path) -> None:
    source = data_samples.write(
        tmp_path / "a.hdf5",
        data_samples.arrays(6, size=(32, 32), cameras=["high"]),
    )
    out = tmp_path / "sets" / "out"
    adapter.convert([source], out, DUAL_PANDA)
    with pytest.raises(UsageError, match="exists already"):
        adapter.convert([source], out, DUAL_PANDA)
    assert len(read_dataset(out)) == 6
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_the_next_episode_begins_another_file_when_one_is_full(
    made: tuple,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    root, sources, _ = made
    monkeypatch.setattr("minidual.demos.lerobot_adapter._VIDEO_FILE_MB", 0.001)
    tables = adapter.convert(
        sources,
        root.parent / "one_each",
        DUAL_PANDA,
    )  # compares every picture
    files = sorted((root.parent / "one_each").glob("videos/*high*/*/*.mp4"))
    assert len(files) == len(sources) > len(list(root.glob("videos/*high*/*/*.mp4"))) == 1
    np.testing.assert_array_equal(tables.images("high"), read_dataset(root).images("high"))


def test_what_a_killed_conversion_left_is_cleared_and_anothers_work_is_not(tmp_path: Path) -> None:
    own = tmp_path / ".out.999999999.partial"
    other = tmp_path / ".other.999999999.partial"
    for folder in (own, other):
        (folder / "data").mkdir(parents=True)
    source = data_samples.write(
        tmp_path / "a.hdf5",
        data_samples.arrays(6, size=(32, 32), cameras=["high"]),
    )
    adapter.convert([source], tmp_path / "out", DUAL_PANDA)
    assert not own.exists()
    assert other.exists()


def test_the_same_recordings_give_the_same_bytes(made: tuple, tmp_path: Path) -> None:
    root, sources, _ = made
    again = tmp_path / "dataset"
    adapter.convert(sources, again, DUAL_PANDA)
    names = sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert [
        name for name in names if (root / name).read_bytes() != (again / name).read_bytes()
    ] == []


def test_a_video_that_lerobot_cannot_write_ends_the_conversion_with_one_message(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def full(file: str, mode: str = "r", **options: object) -> Any:
        if mode == "w":
            raise OSError(28, "No space left on device", file)
        return opened(file, mode, **options)

    opened = av.open
    source = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(6))
    monkeypatch.setattr(av, "open", full)
    with pytest.raises(EnvironmentMissingError, match=r"no space left on the disk of .*out"):
        adapter.convert([source], tmp_path / "out", DUAL_PANDA)
    assert caplog.records == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["e.hdf5"]


def test_an_error_of_whoever_records_is_no_error_of_the_disk(made: tuple, tmp_path: Path) -> None:
    def recorded() -> Iterator[Path]:
        yield made[1][0]
        raise RuntimeError("a worker died")

    with pytest.raises(RuntimeError, match="a worker died"):
        adapter.convert(recorded(), tmp_path / "set", DUAL_PANDA)
    assert list(tmp_path.iterdir()) == []


def test_a_video_that_lerobot_does_not_end_in_time_ends_the_conversion(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    from lerobot.datasets.video_utils import StreamingVideoEncoder, _CameraEncoderThread

    source = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(6))
    finish = StreamingVideoEncoder.finish_episode
    alive = _CameraEncoderThread.is_alive

    def late_finish(self: StreamingVideoEncoder) -> dict[str, Any]:
        monkeypatch.setattr(_CameraEncoderThread, "is_alive", lambda thread: True)
        try:
            return finish(self)
        finally:
            monkeypatch.setattr(_CameraEncoderThread, "is_alive", alive)

    monkeypatch.setattr(StreamingVideoEncoder, "finish_episode", late_finish)
    with pytest.raises(
        DataError,
        match=r"out could not be written: Encoder thread for .* did not finish in time",
    ):
        adapter.convert([source], tmp_path / "out", DUAL_PANDA)
    assert caplog.records == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["e.hdf5"]


def test_a_dataset_leads_as_its_episodes_do(made: tuple, scene: SceneConfig) -> None:
    root, sources, _ = made
    leader = ReplayLeader(DUAL_PANDA, ReplayConfig(path=str(root)))
    leader.align(sample_trial(scene, 1, "demonstrations", 1), DUAL_PANDA.home)
    episode = read_episode(sources[1], cameras=())
    for k in range(len(episode)):
        sample = leader.read(k / 50)
        assert sample is not None
        np.testing.assert_allclose(sample.q, episode.action[k], atol=1e-6)
        np.testing.assert_allclose(sample.openings, episode.action_gripper[k], atol=1e-6)
