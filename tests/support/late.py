"""Modules that tests import at first use: PyTorch and LeRobot take ten seconds, which one test process is to pay."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any


class _Late(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what pytest asks of everything that it collects
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)

    def __setattr__(self, name: str, value: Any) -> None:
        # monkeypatch would take it back by deleting it: it looks for it in the stand-in's own names.
        raise TypeError(
            f"patch the module itself: monkeypatch.setattr('{self.__name__}.{name}', ...)"
        )


def late(name: str) -> Any:
    """Return a module that is imported when something in it is first looked up."""
    return _Late(name)
