"""Settings that a run remembers: the --set and --seed options of its stages.

Later commands in the run apply them before their own, so that nobody types them again.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import TypeAdapter

from minidual.config.loader import Override
from minidual.durable import read_json, write_text
from minidual.errors import DataError
from minidual.gate.canonical import dumps

MEMORY_FILE = "remembered.json"
_BYTES_MAX = 1_000_000

Memory = dict[str, str]
"""{configuration path: value as typed}."""


def read_memory(folder: Path) -> Memory | None:
    """Return the settings that the run in `folder` remembers; None if it never remembered any.

    Raises:
        DataError: The file is damaged.
    """
    path = folder / MEMORY_FILE
    if not path.exists():
        return None
    try:
        return TypeAdapter(Memory).validate_python(read_json(path, _BYTES_MAX), strict=True)
    except (DataError, ValueError) as error:
        raise DataError(
            f"{path} is damaged: it must be a JSON object of texts",
            remedy="delete it, or type minidual config forget for that run",
        ) from error


def write_memory(folder: Path, memory: Memory) -> None:
    """Make the run in `folder` remember this and nothing else."""
    path = folder / MEMORY_FILE
    if not memory and not path.exists():
        return
    write_text(path, dumps(memory))


def memory_of(overrides: Iterable[Override]) -> Memory:
    """Return the typed values that a run remembers: those of --set and --seed."""
    memory: Memory = {}
    for override in overrides:
        if override.text.startswith("--set "):
            memory = without(memory, [override.path])
            memory[override.path] = override.text.partition("=")[2]
        elif override.path == "seed":
            memory[override.path] = str(override.value)
    return memory


def without(memory: Memory, paths: Sequence[str]) -> Memory:
    """Return the settings that are neither one of `paths` nor below one."""
    return {
        name: text
        for name, text in memory.items()
        if not any(name == path or name.startswith(f"{path}.") for path in paths)
    }


def as_typed(memory: Memory) -> list[str]:
    """Return the settings as they are typed: "--set a.b=value"."""
    return [f"--set {name}={text}" for name, text in memory.items()]
