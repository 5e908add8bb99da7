"""Folder of numba's compiled kernels, and the message where there can be none."""

import logging
import os
from pathlib import Path
from typing import Any, cast

from numba.core import config

from minidual.durable import expanded
from minidual.variables import is_writable, private_folder

numba_config = cast(Any, config)  # its fields are made when it is imported
_LOGGER = logging.getLogger("minidual")
_SAID = "MINIDUAL_UNCACHED_SAID"
"""Variable that tells worker processes that the message was printed."""
_NOWHERE = (
    "minidual: no folder for compiled kernels can be written: each process compiles them again, "
    "for about a minute\n  remedy: set NUMBA_CACHE_DIR to a folder that can be written"
)
_TEMPORARY = (
    "minidual: the numeric kernels are compiled into %s, for about a minute\n"
    "  remedy: set NUMBA_CACHE_DIR to a folder that is kept, to compile them once"
)


def choose_folder(source_folder: Path) -> None:
    """Let numba keep kernels in a folder for temporary files if it can write nowhere else.

    A warning is logged when kernels are compiled there for the first time, and when there is no
    such folder either.

    Args:
        source_folder: Of a module with kernels.
    """
    if _own_folder(source_folder) is not None:
        return
    private = private_folder()
    if private is None:
        if _SAID not in os.environ:
            os.environ[_SAID] = "1"
            _LOGGER.warning(_NOWHERE)
        return
    folder = private / "numba"
    os.environ["NUMBA_CACHE_DIR"] = str(folder)  # for worker processes
    numba_config.CACHE_DIR = str(folder)
    if not folder.exists():
        _LOGGER.warning(_TEMPORARY, folder)
        folder.mkdir(exist_ok=True)


def _own_folder(source_folder: Path) -> Path | None:
    """Return the folder that numba chooses by itself, or None if it can write none of its own."""
    named = numba_config.CACHE_DIR
    user_cache = expanded(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    folders = [source_folder / "__pycache__"]
    if named:
        folders.insert(0, Path(named))
    if user_cache.is_absolute():  # it is not where no home folder is known
        folders.append(user_cache / "numba")
    return next((folder for folder in folders if is_writable(folder)), None)
