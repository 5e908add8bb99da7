"""Files of a recording, of its dataset and of a checkpoint, broken and read by what reads them."""

from __future__ import annotations

import importlib
import json
import pickle
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.seeds import stream
from minidual.errors import MinidualError
from scripts.campaign.case import Case, Place, Result, has_control_characters
from scripts.campaign.tampering import BYTE_CHANGES, Change, rewrite
from scripts.campaign.values import Where, dotted, places, replace

_LIMIT_S = 40.0
_PLACES_N = 60
"""Values of a JSON file that are replaced."""
_STRANGE = (None, -1, "\x1b[2J", [], {}, 1e300)
_PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
_MODULES = (
    "minidual.demos.episode",
    "minidual.demos.lerobot_reader",
    "minidual.policies.act",
    "minidual.policies.demonstrations",
    "minidual.policies.kinds",
)
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


def warm(place: Place) -> None:
    """Import what the readers need; nothing is read here, since that would start threads."""
    for module in _MODULES:
        importlib.import_module(module)


def library_cases(source: Path) -> Iterator[Case]:
    """Each kind of file with broken bytes and replaced values, and checkpoints that run programs."""
    yield from _kind_cases("episode", _files(source, "teleop-record/episodes")[:1], source)
    yield from _kind_cases("dataset", _files(source, "teleop-record/lerobot"), source)
    yield from _kind_cases("checkpoint", _files(source, "train-act/checkpoint"), source)
    for file in _PROCESSORS:
        for number in range(len(PROGRAMS)):
            body = partial(_program, file, number)
            yield Case(f"checkpoint {file} program {number}", body, _LIMIT_S)
    yield Case("checkpoint weights as pickle", _pickled, _LIMIT_S)


def _files(source: Path, name: str) -> list[str]:
    """Return the files in a folder of the run, relative to the run."""
    paths = (path for path in (source / name).rglob("*") if path.is_file())
    return sorted(path.relative_to(source).as_posix() for path in paths)


def _kind_cases(kind: str, names: list[str], source: Path) -> Iterator[Case]:
    draws_n = 12 if kind == "episode" else 2
    for name in names:
        label = f"{kind} {Path(name).name}"
        for change in BYTE_CHANGES:
            for number in range(draws_n):
                body = partial(_bytes, kind, name, change)
                yield Case(f"{label} {change.__name__} {number}", body, _LIMIT_S)
        if not name.endswith(".json"):
            continue
        record = json.loads((source / name).read_bytes())
        for where in list(places(record))[:_PLACES_N]:
            for strange in _STRANGE:
                body = partial(_json_value, kind, name, where, strange)
                yield Case(f"{label} {dotted(where)} {strange!r}", body, _LIMIT_S)


def _bytes(kind: str, name: str, change: Change, place: Place, result: Result) -> None:
    change(place.runs / "smoke" / name, place.rng)
    read_file(kind, name, place, result)


def _json_value(
    kind: str,
    name: str,
    where: Where,
    strange: Any,
    place: Place,
    result: Result,
) -> None:
    path = place.runs / "smoke" / name
    record = json.loads(path.read_bytes())
    replace(record, where, strange)
    rewrite(path, json.dumps(record).encode())
    read_file(kind, name, place, result)


def _checkpoint_file(place: Place, name: str) -> Path:
    return place.runs / "smoke" / "train-act" / "checkpoint" / name


def _program(file: str, number: int, place: Place, result: Result) -> None:
    """Read a checkpoint with a step that would make a file."""
    made = place.folder / "made"
    path = _checkpoint_file(place, file)
    record = json.loads(path.read_bytes())
    record["steps"][0] = json.loads(json.dumps(PROGRAMS[number]).replace("{}", str(made)))
    rewrite(path, json.dumps(record).encode())
    read_file("checkpoint", file, place, result)
    if made.exists():
        result.forbidden.append("a checkpoint ran a program")
    if "refused" not in result.outcomes:
        result.forbidden.append("a silent pass: the step is taken")


class _Touch:
    """Makes a file when it is unpickled."""

    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.made,))


def _pickled(place: Place, result: Result) -> None:
    """Read a checkpoint whose weights are a pickle that would make a file."""
    made = place.folder / "made"
    path = _checkpoint_file(place, "model.safetensors")
    rewrite(path, pickle.dumps(_Touch(made)))
    read_file("checkpoint", path.name, place, result)
    if made.exists() or "refused" not in result.outcomes:
        result.forbidden.append("pickled weights are read")


def read_file(kind: str, name: str, place: Place, result: Result) -> None:
    """Read an episode, a dataset or a checkpoint of the copied run with what reads it."""
    run = place.runs / "smoke"
    try:
        match kind:
            case "episode":
                _read_episode(run / name, result)
            case "dataset":
                _read_dataset(run / "teleop-record" / "lerobot", result)
            case _:
                _read_checkpoint(run / "train-act" / "checkpoint", result)
    except MinidualError as error:
        result.saw("refused")
        if has_control_characters(error.message):
            result.saw("refused, with control characters")


def _read_episode(path: Path, result: Result) -> None:
    from minidual.demos.episode import inspect_episode

    _, faults = inspect_episode(path)
    result.saw("named" if faults else "harmless")


def _read_dataset(folder: Path, result: Result) -> None:
    from minidual.policies.demonstrations import load_demonstrations

    demonstrations = load_demonstrations(folder, ())
    states_finite = np.isfinite(demonstrations.state).all()
    actions_finite = np.isfinite(demonstrations.action).all()
    if not (states_finite and actions_finite):
        result.forbidden.append("a silent pass: a number is not finite")
    result.saw("harmless")


def _read_checkpoint(folder: Path, result: Result) -> None:
    from minidual.policies.kinds import load_policy

    policy = load_policy(folder, threads=1)
    rng = stream(0, "campaign.pictures")
    images = {
        camera: rng.integers(0, 255, (*size, 3), np.uint8)
        for camera, size in policy.cameras.items()
    }
    actions = policy.predict(images, np.zeros(policy.dim, np.float32))
    if not np.isfinite(actions).all():
        result.forbidden.append("a silent pass: an action is not finite")
    result.saw("harmless")
