"""The one table of back-ends, and the way to make one."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from minidual.config.view import ViewConfig
from minidual.errors import EnvironmentMissingError, unknown_name
from minidual.show.view.protocol import View

Say = Callable[[str], None]
"""Prints one line where people read."""

NONE = "none"
BACKENDS: dict[str, str] = {"native": "minidual.show.view.native:NativeView", "web": "minidual.show.view.web:WebView"}
NAMES: tuple[str, ...] = (NONE, *BACKENDS)
"""What `--view` takes."""


def make_view(name: str, config: ViewConfig | None = None, *, say: Say = print) -> View | None:
    """Return the view `name`, or None for "none": who has no view pays nothing.

    Args:
        name: One of NAMES.
        config: Interface, port and rate; the defaults bind the loopback interface only.
        say: Gets the few lines that people must read: the address, a warning, that a view ended early.

    Raises:
        UsageError: Unknown name, an interface that this machine does not have, no free port.
        EnvironmentMissingError: The back-end's library or the display is not there.
    """
    if name not in NAMES:
        raise unknown_name("view", name, NAMES)
    if name == NONE:
        return None
    module, _, attribute = BACKENDS[name].partition(":")
    try:
        make: Any = getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("minidual"):
            raise
        raise EnvironmentMissingError(
            f"view '{name}' needs the library '{error.name}', which is not installed",
            remedy="install minidual with its dependencies again (`make setup` in a checkout), or --view none",
        ) from error
    return make(config or ViewConfig(), say)
