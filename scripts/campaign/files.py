"""Broken and hostile input files: recordings, scenes, goals, episodes, datasets, checkpoints, caches."""

from __future__ import annotations

import importlib
import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from minidual.config.seeds import stream
from minidual.errors import ExitCode, MinidualError
from scripts.campaign.case import Case, Place, Result, command, judge
from scripts.campaign.tampering import (
    append,
    burst,
    device,
    flip,
    folder,
    foreign,
    loop,
    noise,
    pipe,
    rewrite,
    truncate,
)

ROOT = Path(__file__).resolve().parents[2]
BYTES = (flip, burst, truncate, append, noise, folder, loop, foreign, pipe, device)
REFUSED = (ExitCode.USAGE, ExitCode.ENVIRONMENT, ExitCode.NOTHING_EVALUATED)


# ---- recordings ------------------------------------------------------------------------------------------------------

ARRAY_CHANGES: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "NaN": lambda a, rng: _one(a, np.nan, rng),
    "inf": lambda a, rng: _one(a, np.inf, rng),
    "huge": lambda a, rng: _one(a, 1e300, rng),
    "tiny": lambda a, rng: _one(a, 1e-300, rng),
    "negative": lambda a, rng: _one(a, -7, rng),
    "zero": lambda a, rng: _one(a, 0, rng),
    "nine": lambda a, rng: _one(a, 9, rng),
    "one more": lambda a, rng: _one(a, a.flat[0] + 1 if a.size else 0, rng),
    "all NaN": lambda a, rng: np.full(a.shape, np.nan),
    "empty": lambda a, rng: a[:0] if a.ndim else np.empty(0),
    "half": lambda a, rng: a[: len(a) // 2] if a.ndim else a,
    "transposed": lambda a, rng: a.T,
    "deeper": lambda a, rng: a[None],
    "scalar": lambda a, rng: np.array(1.0),
    "text": lambda a, rng: np.array("text"),
    "complex": lambda a, rng: a.astype(complex),
    "bool": lambda a, rng: a.astype(bool),
    "integer": lambda a, rng: np.nan_to_num(a).astype(np.int64),
    "big-endian": lambda a, rng: a.astype(a.dtype.newbyteorder(">")) + np.ones((), a.dtype),
}


def _one(array: np.ndarray, value: float, rng: np.random.Generator) -> np.ndarray:
    changed = np.array(
        array,
        dtype=float if array.dtype != np.int64 or not np.isfinite(value) else None,
    )
    if changed.size:
        with np.errstate(all="ignore"):
            changed.flat[int(rng.integers(changed.size))] = (
                value if changed.dtype == float else int(np.clip(value, -9e18, 9e18))
            )
    return changed


HEADER_CHANGES: dict[str, Any] = {
    "null": None, "number": -1e300, "text": "\x1b]0;owned\x07\x1b[2J\u202e", "list": [1], "object": {"a": {}},
    "true": True, "long": "x" * 100_000,
}  # fmt: skip


def warm_recordings(place: Place) -> None:
    """Load what a replay needs."""
    _replay(place, place.source / "carry" / "worst.npz", Result(), changed="")


def warm_scenes(place: Place) -> None:
    """Load what a plan needs."""
    for name, words in (("bench-scene", "--acm --scene {}"), ("beside-post", "--to {}")):
        _plan(words, _copied_scene(name, place), place, Result())


def warm_readers(place: Place) -> None:
    """Import what the readers need; nothing is read here, since that would start threads."""
    for name in (
        "demos.episode",
        "demos.lerobot_reader",
        "policies.act",
        "policies.demonstrations",
        "policies.kinds",
    ):
        importlib.import_module(f"minidual.{name}")


def recording_cases(source: Path) -> Iterator[Case]:
    """Every array and header field of a recording in every strange form, and its bytes broken."""
    arrays = _arrays(source)
    for name in arrays:
        for change in ARRAY_CHANGES if name != "header" else ():
            yield Case(f"{name} {change}", partial(_array, name, change), limit_s=25.0)
        yield Case(f"{name} missing", partial(_array, name, ""), limit_s=25.0)
    header = json.loads(arrays["header"].tobytes())
    for path in _paths(header):
        for change in HEADER_CHANGES:
            yield Case(
                f"header {'.'.join(path)} {change}",
                partial(_header, path, change),
                limit_s=25.0,
            )
    for change in BYTES:
        for number in range(6):
            yield Case(
                f"bytes {change.__name__} {number}",
                partial(_recording_bytes, change),
                limit_s=25.0,
            )
    for name in ("pickle", "bomb", "sparse", "empty zip", "wrong suffix"):
        yield Case(f"file {name}", partial(_recording_file, name), limit_s=25.0)


def _arrays(source: Path) -> dict[str, Any]:
    with np.load(source / "carry" / "worst.npz", allow_pickle=False) as stored:
        return dict(stored)


def _paths(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if path:
        yield path
    for key, inner in value.items() if isinstance(value, dict) and len(path) < 3 else ():
        yield from _paths(inner, (*path, key))


_WORDS = ("--to-s", "0.2", "--json")
"""One check point lies in this stretch; a whole replay would take seconds."""


def _replay(place: Place, path: Path, result: Result, *, changed: str) -> None:
    ran = command(place, "replay", str(path), *_WORDS, "--runs-dir", str(place.folder / "none"))
    judge(result, "replay", ran, [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED, *REFUSED])
    if ran.code == ExitCode.PASS and changed == "physics":
        result.forbidden.append("a silent pass: changed physics is replayed as if it were recorded")
    if any(ord(sign) < 32 and sign not in "\n\t" for sign in ran.err) or "\u202e" in ran.err:
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    result.saw("passes" if ran.code == 0 else "does not repeat" if ran.code == 1 else "refused")


def _array(name: str, change: str, place: Place, result: Result) -> None:
    arrays = _arrays(place.source)
    before = arrays.pop(name)
    if change:
        arrays[name] = after = ARRAY_CHANGES[change](before, place.rng)
        same = (
            after.shape == before.shape
            and after.dtype.kind in "fi"
            and np.array_equal(after, before)
        )
    else:
        same = False
    path = place.folder / "case.npz"
    np.savez(path, **arrays)
    # What lies behind the replayed stretch is not looked at; the model and the first state always are.
    physics = name.startswith("model.") and not same
    _replay(place, path, result, changed="physics" if physics else "")


def _header(where: tuple[str, ...], change: str, place: Place, result: Result) -> None:
    arrays = _arrays(place.source)
    header = json.loads(arrays["header"].tobytes())
    inner = header
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = HEADER_CHANGES[change]
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    path = place.folder / "case.npz"
    np.savez(path, **arrays)
    _replay(place, path, result, changed="")
    ran = command(
        place,
        "replay",
        str(path),
        "--to-s",
        "0.05",
        "--runs-dir",
        str(place.folder / "none"),
    )
    if (
        any(ord(sign) < 32 and sign not in "\n\t" for sign in ran.out + ran.err)
        or "\u202e" in ran.out + ran.err
    ):
        result.forbidden.append("an escape sequence of the file reaches the terminal")


def _recording_bytes(change: Callable[..., None], place: Place, result: Result) -> None:
    path = place.folder / "case.npz"
    shutil.copy(place.source / "carry" / "worst.npz", path)
    change(path, place.rng)
    _replay(place, path, result, changed="")


def _recording_file(name: str, place: Place, result: Result) -> None:
    path = place.folder / "case.npz"
    arrays = _arrays(place.source)
    if name == "pickle":
        arrays["controls"] = np.array([{"a": 1}], dtype=object)
        np.savez(path, **arrays)
    elif name == "bomb":
        with (
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
            archive.open("controls.npy", "w") as stream,
        ):
            shape = (1 << 40, 16)
            np.lib.format.write_array_header_1_0(
                stream,
                {"descr": "<f8", "fortran_order": False, "shape": shape},
            )
            stream.write(bytes(1 << 20))
    elif name == "sparse":
        with path.open("wb") as stream:
            stream.truncate(1 << 40)
    elif name == "empty zip":
        zipfile.ZipFile(path, "w").close()
    else:
        path.write_text("hello")
    _replay(place, path, result, changed="")


# ---- scenes and goals ------------------------------------------------------------------------------------------------

STRANGE = (
    None,
    [],
    {},
    -1,
    0,
    1e-300,
    1e300,
    float("nan"),
    float("inf"),
    "text",
    True,
    [[]],
    [1] * 5000,
    "x" * 9000,
)


def scene_cases(source: Path) -> Iterator[Case]:
    """Scene and goal files with values replaced, and their bytes broken."""
    for name, words in (
        ("bench-scene", "--acm --scene {}"),
        ("beside-post", "--to {}"),
        ("straight-down", "--to {}"),
    ):
        tree = yaml.safe_load((ROOT / "examples" / f"{name}.yaml").read_text(encoding="utf-8"))
        for path in _places(tree):
            for number in range(len(STRANGE)):
                text = ".".join(map(str, path))
                yield Case(
                    f"{name} {text} {number}",
                    partial(_scene_value, name, words, path, number),
                    limit_s=30.0,
                )
        for change in BYTES:
            for number in range(4):
                case = partial(_scene_bytes, name, words, change)
                yield Case(f"{name} bytes {change.__name__} {number}", case, limit_s=30.0)


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, inner in items:
        yield from _places(inner, (*path, key))


def _plan(words: str, path: Path, place: Place, result: Result) -> None:
    ran = command(
        place, "plan", *words.format(path).split(" "), "--json", "--runs-dir", str(place.folder / "none"),
        *(("--budget-s", "3") if "--to" in words else ()),
    )  # fmt: skip
    judge(result, "plan", ran, [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED, *REFUSED])
    if any(ord(sign) < 32 and sign not in "\n\t" for sign in ran.err):
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if ran.code == ExitCode.PASS and not all(
        np.isfinite(number) for number in _numbers(json.loads(ran.out))
    ):
        result.forbidden.append("a silent pass: a number of the plan is not finite")
    result.saw("taken" if ran.code == 0 else "no plan" if ran.code == 1 else "refused")


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, float | int):
        yield value
    for inner in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    ):
        yield from _numbers(inner)


def _copied_scene(name: str, place: Place) -> Path:
    for file in (ROOT / "examples").iterdir():
        if file.is_file():
            shutil.copy(file, place.folder)
    return place.folder / f"{name}.yaml"


def _scene_value(
    name: str,
    words: str,
    where: tuple[Any, ...],
    number: int,
    place: Place,
    result: Result,
) -> None:
    path = _copied_scene(name, place)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    inner = tree
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = STRANGE[number]
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    _plan(words, path, place, result)


def _scene_bytes(
    name: str,
    words: str,
    change: Callable[..., None],
    place: Place,
    result: Result,
) -> None:
    path = _copied_scene(name, place)
    change(path, place.rng)
    _plan(words, path, place, result)


# ---- episodes, datasets, checkpoints ---------------------------------------------------------------------------------


def library_cases(source: Path) -> Iterator[Case]:
    """Files of a recording, of its dataset and of a checkpoint broken byte by byte, read by what reads them."""
    episodes = [
        f"teleop-record/episodes/{path.name}"
        for path in sorted((source / "teleop-record/episodes").iterdir())
    ]
    dataset = _files(source, "teleop-record/lerobot")
    checkpoint = _files(source, "train-act/checkpoint")
    for kind, names in (
        ("episode", episodes[:1]),
        ("dataset", dataset),
        ("checkpoint", checkpoint),
    ):
        for name in names:
            for change in BYTES:
                for number in range(12 if kind == "episode" else 2):
                    case = partial(_read, kind, name, change)
                    yield Case(
                        f"{kind} {Path(name).name} {change.__name__} {number}",
                        case,
                        limit_s=40.0,
                    )
            if name.endswith(".json"):
                record = json.loads((source / name).read_bytes())
                for path in list(_places(record))[:60]:
                    for strange in (None, -1, "\x1b[2J", [], {}, 1e300):
                        text = ".".join(map(str, path))
                        case = partial(_json_value, kind, name, path, strange)
                        yield Case(
                            f"{kind} {Path(name).name} {text} {strange!r}",
                            case,
                            limit_s=40.0,
                        )

    for file in ("policy_preprocessor.json", "policy_postprocessor.json"):
        for number in range(len(PROGRAMS)):
            yield Case(
                f"checkpoint {file} program {number}",
                partial(_program, file, number),
                limit_s=40.0,
            )
    yield Case("checkpoint weights as pickle", _pickled, limit_s=40.0)


PROGRAMS: tuple[dict[str, Any], ...] = (
    {"class": "os.system", "config": {"command": "touch {}"}},
    {"class": "subprocess.Popen", "config": {"args": ["touch", "{}"]}},
    {"class": "builtins.exec", "config": {"source": "open('{}', 'w')"}},
    {
        "registry_name": "rename_observations_processor",
        "class": "os.system",
        "config": {"command": "touch {}"},
    },
    {"registry_name": "os.system", "config": {"command": "touch {}"}},
)
"""Steps of a processor that would make a file."""


def _program(file: str, number: int, place: Place, result: Result) -> None:
    made = place.folder / "made"
    path = place.runs / "smoke" / "train-act" / "checkpoint" / file
    record = json.loads(path.read_bytes())
    record["steps"][0] = json.loads(json.dumps(PROGRAMS[number]).replace("{}", str(made)))
    rewrite(path, json.dumps(record).encode())
    look("checkpoint", file, place, result)
    if made.exists():
        result.forbidden.append("a checkpoint ran a program")
    if "refused" not in result.outcomes:
        result.forbidden.append("a silent pass: the step is taken")


class _Touch:
    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.made,))


def _pickled(place: Place, result: Result) -> None:
    made = place.folder / "made"
    path = place.runs / "smoke" / "train-act" / "checkpoint" / "model.safetensors"
    rewrite(path, pickle.dumps(_Touch(made)))
    look("checkpoint", path.name, place, result)
    if made.exists() or "refused" not in result.outcomes:
        result.forbidden.append("pickled weights are read")


def _files(source: Path, name: str) -> list[str]:
    return sorted(
        p.relative_to(source).as_posix() for p in (source / name).rglob("*") if p.is_file()
    )


def _read(kind: str, name: str, change: Callable[..., None], place: Place, result: Result) -> None:
    change(place.runs / "smoke" / name, place.rng)
    look(kind, name, place, result)


def _json_value(
    kind: str,
    name: str,
    where: tuple[Any, ...],
    strange: Any,
    place: Place,
    result: Result,
) -> None:
    path = place.runs / "smoke" / name
    record = json.loads(path.read_bytes())
    inner = record
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = strange
    path.unlink()
    path.write_text(json.dumps(record), encoding="utf-8")
    look(kind, name, place, result)


def look(kind: str, name: str, place: Place, result: Result) -> None:
    """Read an episode, a dataset or a checkpoint of the copied run with what reads it."""
    run = place.runs / "smoke"
    try:
        if kind == "episode":
            from minidual.demos.episode import inspect_episode

            _, faults = inspect_episode(run / name)
            result.saw("named" if faults else "harmless")
        elif kind == "dataset":
            from minidual.policies.demonstrations import load_demonstrations

            demos = load_demonstrations(run / "teleop-record" / "lerobot", ())
            if not (np.isfinite(demos.state).all() and np.isfinite(demos.action).all()):
                result.forbidden.append("a silent pass: a number is not finite")
            result.saw("harmless")
        else:
            from minidual.policies.kinds import load_policy

            policy = load_policy(run / "train-act" / "checkpoint", threads=1)
            rng = stream(0, "campaign.pictures")
            images = {
                camera: rng.integers(0, 255, (*size, 3), np.uint8)
                for camera, size in policy.cameras.items()
            }
            chunk = policy.predict(images, np.zeros(policy.dim, np.float32))
            if not np.isfinite(chunk).all():
                result.forbidden.append("a silent pass: an action is not finite")
            result.saw("harmless")
    except MinidualError as error:
        result.saw("refused")
        if any(ord(sign) < 32 and sign not in "\n\t" for sign in error.message):
            result.saw("refused, with control characters")


# ---- the cache of allowed collisions ---------------------------------------------------------------------------------


def cache_cases(source: Path) -> Iterator[Case]:
    """The cache of allowed collisions with rows added, broken bytes and strange files."""
    for name in (
        "rows added",
        "rows removed",
        "rows edited",
        "empty",
        "not JSON",
        "other robot",
        "digest of old",
    ):
        yield Case(name, partial(_cache, name), limit_s=40.0)
    for change in BYTES:
        for number in range(3):
            yield Case(f"{change.__name__} {number}", partial(_cache_bytes, change), limit_s=40.0)


_BUILT: dict[str, bytes] = {}
_PAIRS: set[tuple[str, str]] = set()


def warm_caches(place: Place) -> None:
    """Build the cache once."""
    os.environ["MINIDUAL_CACHE"] = str(place.folder / "cache")
    _PAIRS.update(_allowed(place))
    _BUILT.update(
        {path.name: path.read_bytes() for path in (place.folder / "cache").glob("acm-*.json")},
    )


def _cached(place: Place) -> tuple[Path, set[tuple[str, str]]]:
    """Write the built cache; return its file and the allowed pairs."""
    os.environ["MINIDUAL_CACHE"] = str(place.folder / "cache")
    ((name, content),) = _BUILT.items()
    (place.folder / "cache").mkdir()
    (place.folder / "cache" / name).write_bytes(content)
    return place.folder / "cache" / name, _PAIRS


def _allowed(place: Place, result: Result | None = None) -> set[tuple[str, str]]:
    from minidual.collision.acm import acm_report

    acm_report.cache_clear()
    ran = command(place, "plan", "--acm", "--json", "--runs-dir", str(place.folder / "none"))
    if result is not None:
        judge(result, "plan --acm", ran, [ExitCode.PASS])
    return (
        {(row["first"], row["second"]) for row in ran.document()["allowed"]}
        if ran.code == 0
        else set()
    )


def _cache(name: str, place: Place, result: Result) -> None:
    path, pairs = _cached(place)
    digest, _, content = path.read_text(encoding="utf-8").partition("\n")
    record = json.loads(content)
    links = sorted({link for row in record["pairs"] for link in row[:2]})
    if name == "rows added":
        record["pairs"] += [[a, b, "never"] for a in links[:6] for b in links[-6:]]
    elif name == "rows removed":
        record["pairs"] = record["pairs"][:-5]
    elif name == "rows edited":
        record["pairs"][0] = [links[0], links[-1], "adjacent"]
    changed = json.dumps(record)
    texts = {"empty": "", "not JSON": f"{digest}\nhello", "other robot": f"{'0' * 64}\n{changed}"}
    path.write_text(texts.get(name, f"{digest}\n{changed}"), encoding="utf-8")
    _compare(pairs, name == "digest of old", place, result)


def _cache_bytes(change: Callable[..., None], place: Place, result: Result) -> None:
    path, pairs = _cached(place)
    change(path, place.rng)
    _compare(pairs, False, place, result)


def _compare(pairs: set[tuple[str, str]], same: bool, place: Place, result: Result) -> None:
    if _allowed(place, result) != pairs:
        result.forbidden.append("a silent pass: other pairs are allowed")
    result.saw("read" if same else "built again")
