"""Options of the live view."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minidual.errors import UsageError

if TYPE_CHECKING:
    from minidual.cli.session import Session
    from minidual.show.view import View


@dataclass(frozen=True)
class Watching:
    """Options of watchable commands; they never change a verdict."""

    view: Annotated[str | None, typer.Option(metavar="none|web", help="Watch the arms in a browser.")] = None
    view_host: Annotated[
        str | None,
        typer.Option(help="Interface for --view web (default 127.0.0.1: this machine and ssh tunnels only)."),
    ] = None
    view_port: Annotated[int | None, typer.Option(help="First port to try for --view web (default 8080).")] = None


@contextmanager
def live_view(session: Session, values: Mapping[str, Any], default: str = "none") -> Generator[View | None]:
    """Yield the selected view or None; close it at the end.

    Raises:
        UsageError: Host or port without a web view, or raised by make_view.
    """
    from minidual.config.loader import Override
    from minidual.show.view import make_view

    name = values.get("view") or default
    typed = {field: values.get(f"view_{field}") for field in ("host", "port")}
    overrides = [Override(f"view.{f}", v, f"--view-{f} {v}") for f, v in typed.items() if v is not None]
    if overrides and name != "web":
        raise UsageError(f"{overrides[0].text.split()[0]} goes with --view web, not with --view {name}")
    view = make_view(name, session.loaded.with_overrides(overrides).config.view, say=session.say)
    try:
        yield view
    finally:
        if view is not None:
            view.close()
