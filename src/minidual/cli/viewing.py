"""View options and the view they select."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minidual.errors import UsageError

if TYPE_CHECKING:
    from minidual.cli.session import Session
    from minidual.show.view import View

VIEW_OPTIONS: dict[str, tuple[Any, Any]] = {
    "view": (Annotated[str | None, typer.Option(metavar="none|web", help="Watch the arms in a browser.")], None),
    "view_host": (
        Annotated[
            str | None,
            typer.Option(help="Interface for --view web (default 127.0.0.1: this machine and ssh tunnels only)."),
        ],
        None,
    ),
    "view_port": (Annotated[int | None, typer.Option(help="First port to try for --view web (default 8080).")], None),
}
"""Options of watchable commands; they never change a verdict."""


@contextmanager
def live_view(session: Session, values: Mapping[str, Any], default: str = "none") -> Generator[View | None]:
    """Yield the selected view or None; close it at the end.

    Raises:
        UsageError: An address without a web view, or an error of make_view.
    """
    from minidual.show.view import make_view

    name = values.get("view") or default
    typed = {field: values.get(f"view_{field}") for field in ("host", "port")}
    typed = {field: value for field, value in typed.items() if value is not None}
    if typed and name != "web":
        raise UsageError(f"--view-{next(iter(typed))} goes with --view web, not with --view {name}")
    config = session.loaded.config.view
    if typed:
        from minidual.config.loader import Override

        overrides = [Override(f"view.{field}", value, f"--view-{field} {value}") for field, value in typed.items()]
        config = session.loaded.with_overrides(overrides).config.view

    def say(line: str) -> None:
        session.people.print(line, markup=False, highlight=False, soft_wrap=True)

    view = make_view(name, config, say=say)
    try:
        yield view
    finally:
        if view is not None:
            view.close()
