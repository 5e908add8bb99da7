"""Live browser view."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from minidual.config.root import ViewConfig
from minidual.errors import check_name

if TYPE_CHECKING:
    from minidual.show.view.web import WebView

type View = WebView  # evaluated by type checkers only

NAMES = ("none", "web")
"""Values of `--view`."""


def make_view(
    name: str,
    config: ViewConfig | None = None,
    *,
    say: Callable[[str], None] = print,
) -> View | None:
    """Return the view `name`, None for "none"; `say` gets messages.

    Raises:
        UsageError: Unknown name, unusable interface, no free port.
    """
    check_name("view", name, NAMES)
    if name == "none":
        return None
    from minidual.show.view.web import WebView  # viser takes a second to load

    return WebView(config or ViewConfig(), say)
