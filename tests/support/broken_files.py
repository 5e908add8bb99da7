"""Named ways to break an episode, a dataset or a checkpoint: each takes its path and a generator and changes it there.

Every case must be refused by name (DataError or a fault); the reading side is in test_broken_files.py.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.support.late import late

torch = late("torch")
tensor_files = late("safetensors.torch")

Break = Callable[[Path, np.random.Generator], None]
STRANGE: tuple[Any, ...] = (None, "text", [], {}, -1, 1e300, True, [["deep"]])


def truncated(path: Path, rng: np.random.Generator) -> None:
    os.truncate(path, int(rng.integers(path.stat().st_size)))


def emptied(path: Path, rng: np.random.Generator) -> None:
    os.truncate(path, 0)


def noise(path: Path, rng: np.random.Generator) -> None:
    path.write_bytes(rng.bytes(int(rng.integers(1, 4096))))


def pipe(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    os.mkfifo(path)


def folder(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    path.mkdir()


def endless(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def loop(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    path.symlink_to(path)


def sparse(path: Path, rng: np.random.Generator) -> None:
    with path.open("wb") as stream:
        stream.truncate(1 << 40)


def deep(path: Path, rng: np.random.Generator) -> None:
    path.write_text("[" * 100_000)


FILES: tuple[Break, ...] = (truncated, emptied, noise, pipe, folder, endless, loop, sparse)
"""Of any file."""


def within(name: str, change: Break) -> Break:
    """Return a break of the first file of that name below a folder."""

    def broken(path: Path, rng: np.random.Generator) -> None:
        change(sorted(path.rglob(name))[0], rng)

    return broken


# ---- episodes (HDF5) ---------------------------------------------------------------------------------------------


def in_episode(change: Callable[[h5py.File, np.random.Generator], Any]) -> Break:
    """Return a break of an open episode."""

    def broken(path: Path, rng: np.random.Generator) -> None:
        with h5py.File(path, "r+") as file:
            change(file, rng)

    return broken


def _attribute(name: str, value: Any) -> Break:
    return in_episode(lambda file, rng: file.attrs.__setitem__(name, value))


def _array(key: str, make: Callable[[Any], Any]) -> Break:
    def change(file: h5py.File, rng: np.random.Generator) -> None:
        made = make(file[key][()])
        del file[key]
        file.create_dataset(key, data=made)

    return in_episode(change)


def _terabytes(file: h5py.File, rng: np.random.Generator) -> None:
    ticks = int(file.attrs["num_timesteps"])
    camera = next(iter(file["observations/images"]))
    del file[f"observations/images/{camera}"]
    shape = (ticks, 1_000_000, 1_000_000, 3)
    file.create_dataset(
        f"observations/images/{camera}",
        shape=shape,
        dtype="uint8",
        chunks=(1, 96, 128, 3),
    )


def _elsewhere(file: h5py.File, rng: np.random.Generator) -> None:
    shape = file["action"].shape
    del file["action"]
    file.create_dataset(
        "action",
        shape=shape,
        dtype="float64",
        external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)],
    )


def _one(value: float) -> Callable[[Any], Any]:
    def make(array: Any) -> Any:
        array.flat[array.size // 2] = value
        return array

    return make


EPISODE: dict[str, Break] = {
    **{change.__name__: change for change in FILES},
    "ticks negative": _attribute("num_timesteps", -1),
    "ticks huge": _attribute("num_timesteps", 10**15),
    "ticks infinite": _attribute("num_timesteps", np.inf),
    "ticks a list": _attribute("num_timesteps", [1, 2]),
    "rate text": _attribute("fps", "fast"),
    "rate NaN": _attribute("fps", np.nan),
    "cameras number": _attribute("cameras", 3),
    "cameras null": _attribute("cameras", "null"),
    "extra deep": _attribute("extra", "[" * 50_000),
    "extra list": _attribute("extra", "[1]"),
    "seed infinite": _attribute("seed", np.inf),
    "positions NaN": _array("observations/qpos", _one(np.nan)),
    "actions infinite": _array("action", _one(np.inf)),
    "actions text": _array("action", lambda a: a.astype("S8")),
    "actions complex": _array("action", lambda a: a.astype(complex)),
    "times NaN": _array("timestamps", _one(np.nan)),
    "grippers transposed": _array("observations/gripper", np.transpose),
    "pictures of floats": _array("observations/images/high", lambda a: a.astype(float)),
    "pictures grey": _array("observations/images/high", lambda a: a[..., 0]),
    "pictures of terabytes": in_episode(_terabytes),
    "actions in another file": in_episode(_elsewhere),
}

# ---- datasets (LeRobot) ------------------------------------------------------------------------------------------


def _info(*where: str, value: Any) -> Break:
    def change(path: Path, rng: np.random.Generator) -> None:
        record = json.loads(path.read_text())
        inner = record
        for key in where[:-1]:
            inner = inner[key]
        inner[where[-1]] = value
        path.write_text(json.dumps(record))

    return within("info.json", change)


def _column(folder_: str, name: str, make: Callable[[list[Any]], list[Any] | None]) -> Break:
    def broken(path: Path, rng: np.random.Generator) -> None:
        file = sorted((path / folder_).rglob("*.parquet"))[0]
        table = pq.read_table(file)
        position = table.column_names.index(name)
        values = make(table[name].to_pylist())
        changed = table.remove_column(position)
        if values is not None:
            changed = changed.add_column(position, name, pa.array(values))
        pq.write_table(changed, file)

    return broken


def _set(value: Any) -> Callable[[list[Any]], list[Any]]:
    return lambda values: [*values[:-1], value]


def _video(path: Path, rng: np.random.Generator) -> None:
    """Other pictures of the same size and number."""
    _write_video(path, 1)


def _small_video(path: Path, rng: np.random.Generator) -> None:
    _write_video(path, 2)


def _write_video(path: Path, divide: int) -> None:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        size = (stream.height // divide, stream.width // divide)
        count = stream.frames
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("h264", rate=50)
        stream.height, stream.width, stream.pix_fmt = *size, "yuv444p"
        picture = np.full((*size, 3), 230, np.uint8)
        for _ in range(count):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


HIGH = "observation.images.cam_high"
DATASET: dict[str, Break] = {
    **{f"info {change.__name__}": within("info.json", change) for change in (*FILES, deep)},
    **{f"table {change.__name__}": within("data/*/*.parquet", change) for change in FILES},
    **{f"video {change.__name__}": within("*.mp4", change) for change in FILES},
    **{f"features {value!r}": _info("features", value=value) for value in STRANGE},
    **{f"frames {value!r}": _info("total_frames", value=value) for value in STRANGE},
    "rate text": _info("fps", value="fast"),
    "rate negative": _info("fps", value=-50),
    "pictures of terabytes": _info("features", HIGH, "shape", value=[1_000_000, 1_000_000, 3]),
    "pictures negative": _info("features", HIGH, "shape", value=[-96, 128, 3]),
    "video path": _info(
        "video_path",
        value="{video_key.__class__.__mro__}/{chunk_index:999999999}",
    ),
    "state NaN": _column(
        "data",
        "observation.state",
        lambda v: [*v[:-1], [float("nan")] * len(v[0])],
    ),
    "state text": _column("data", "observation.state", lambda v: ["text"] * len(v)),
    "action short": _column("data", "action", _set([1.0])),
    "action missing": _column("data", "action", lambda v: None),
    "index null": _column("data", "index", _set(None)),
    "episode text": _column("data", "episode_index", lambda v: ["one"] * len(v)),
    "begin huge": _column("meta/episodes", "dataset_to_index", _set(10**15)),
    "begin NaN": _column("meta/episodes", f"videos/{HIGH}/from_timestamp", _set(float("nan"))),
    "chunk negative": _column("meta/episodes", f"videos/{HIGH}/chunk_index", _set(-1)),
    "chunk missing": _column("meta/episodes", f"videos/{HIGH}/chunk_index", lambda v: None),
    "other pictures": within("*.mp4", _video),
    "smaller pictures": within("*.mp4", _small_video),
}

# ---- checkpoints -------------------------------------------------------------------------------------------------


def _record(name: str, change: Callable[[Any], Any]) -> Break:
    def broken(path: Path, rng: np.random.Generator) -> None:
        record = json.loads(path.read_text())
        change(record)
        path.write_text(json.dumps(record))

    return within(name, broken)


def _tensors(name: str, change: Callable[[dict[str, torch.Tensor]], Any]) -> Break:
    def broken(path: Path, rng: np.random.Generator) -> None:
        tensors = tensor_files.load_file(path)
        change(tensors)
        tensor_files.save_file(tensors, path)

    return within(name, broken)


def _first(
    make: Callable[[torch.Tensor], torch.Tensor],
) -> Callable[[dict[str, torch.Tensor]], None]:
    def change(tensors: dict[str, torch.Tensor]) -> None:
        name = sorted(tensors)[0]
        tensors[name] = make(tensors[name]).contiguous()

    return change


_JSON = ("config.json", "policy_preprocessor.json", "policy_postprocessor.json")
_WEIGHTS = (
    "model.safetensors",
    "policy_preprocessor_*.safetensors",
    "policy_postprocessor_*.safetensors",
)
CHECKPOINT: dict[str, Break] = {
    **{
        f"{name} {change.__name__}": within(name, change)
        for name in (*_JSON, *_WEIGHTS)
        for change in FILES
    },
    **{f"{name} deep": within(name, deep) for name in _JSON},
    **{
        f"steps {value!r}": _record(_JSON[1], lambda r, v=value: r.update(steps=v))
        for value in STRANGE
    },
    **{
        f"step {value!r}": _record(_JSON[1], lambda r, v=value: r["steps"].append(v))
        for value in STRANGE
    },
    **{
        f"{name} {value!r}": _record(_JSON[0], lambda r, n=name, v=value: r.update({n: v}))
        for name in ("type", "input_features", "dim_model")
        for value in STRANGE
    },
    "runs a command": _record(
        _JSON[1],
        lambda r: r["steps"].insert(0, {"class": "os.system", "config": {"command": "exit 3"}}),
    ),
    **{f"{name} NaN": _tensors(name, _first(lambda t: t * float("nan"))) for name in _WEIGHTS},
    **{
        f"{name} integers": _tensors(name, _first(lambda t: t.to(torch.int32))) for name in _WEIGHTS
    },
    **{f"{name} deeper": _tensors(name, _first(lambda t: t[None, None])) for name in _WEIGHTS[:1]},
    "a weight missing": _tensors(_WEIGHTS[0], lambda t: t.pop(sorted(t)[0])),
    "a weight more": _tensors(_WEIGHTS[0], lambda t: t.update(more=torch.zeros(3))),
}
