"""The live view and the station of a person who leads, while a recording runs."""

import sys
from collections.abc import Generator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from typing import Any

from minidual.demos.leader import LEADERS, Leader
from minidual.demos.leaders.terminal import BUTTON_KEYS_USAGE, Terminal
from minidual.demos.recording import Observe
from minidual.demos.rig import Rig
from minidual.demos.station import Station
from minidual.demos.terminal_station import KeyStation, LineStation, Stations
from minidual.gate.stage import Context, StageContext
from minidual.show.watch import watch_recording


@contextmanager
def leading(context: StageContext) -> Generator[Observe | None]:
    """Yield the context of each trial; None without a live view and a person who leads.

    A leader that needs a picture gets the live view, although it was not asked for.
    """
    leader = LEADERS[context.config.teleop.leader]
    with ExitStack() as stack:
        view = context.view
        if view is None and leader.features.picture:
            view = stack.enter_context(closing(web_view(context)))
        watch = watch_recording(view)
        if not leader.features.realtime:
            yield watch
            return
        station = station_of(context, leader, view, stack)

        def observe(rig: Rig, index: int) -> AbstractContextManager[object]:
            rig.station = station
            return nullcontext() if watch is None else watch(rig, index)

        yield observe


def web_view(context: Context) -> Any:
    """Return the live view in a browser."""
    from minidual.show.view import make_view  # viser takes a second to load

    return make_view("web", context.config.view, say=context.progress.note)


def station_of(context: Context, leader: type[Leader], view: Any, stack: ExitStack) -> Station:
    """Return the station of a person: lines, a page where there is one, and keys of a terminal."""
    stations: list[Station] = [LineStation(context.progress.note)]
    if view is not None:
        stations.append(view.lead_page())
    stdin = sys.stdin
    if stdin is not None and stdin.isatty() and not leader.features.terminal:
        terminal = Terminal(stdin.fileno(), "the station")
        stations.append(stack.enter_context(closing(KeyStation(terminal))))
        context.progress.note(BUTTON_KEYS_USAGE)
    return Stations(stations)
