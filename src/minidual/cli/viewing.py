"""Options of the live view."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import closing, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from minidual.errors import UsageError
from minidual.gate.table import Option, overrides

if TYPE_CHECKING:
    from minidual.cli.session import Session
    from minidual.show.view import View


WATCHING = (
    Option("view", "Watch the arms in a browser.", metavar="none|web"),
    Option(
        "view-host",
        "Interface for --view web (default 127.0.0.1: this machine and ssh tunnels only).",
        str,
        "view.host",
    ),
    Option("view-port", "First port to try for --view web (default 8080).", int, "view.port"),
)
"""Options of watchable commands; they never change a verdict."""


@contextmanager
def live_view(session: Session, values: Mapping[str, Any], default: str = "none") -> Generator[View | None]:
    """Yield the selected view or None; close it at the end.

    Raises:
        UsageError: Host or port without a web view, or raised by make_view.
    """
    from minidual.show.view import make_view

    name = values.get("view") or default
    typed = overrides(WATCHING, {option.name: values.get(option.key) for option in WATCHING})
    if typed and name != "web":
        raise UsageError(f"{typed[0].text.split()[0]} goes with --view web, not with --view {name}")
    view = make_view(name, session.loaded.with_overrides(typed).config.view, say=session.say)
    with nullcontext() if view is None else closing(view):
        yield view
