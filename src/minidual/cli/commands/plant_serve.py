"""`minidual plant serve`."""

import signal
import threading
from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.errors import ExitCode, UsageError


def plant_serve(
    *,
    hosts: Annotated[
        str,
        typer.Option(metavar="HOST,HOST", help="Addresses of the left and right controller."),
    ] = "127.0.0.1,127.0.0.2",
    pace: Annotated[
        str,
        typer.Option(
            metavar="real|client",
            help="real: a millisecond is a millisecond. client: wait for late commands.",
        ),
    ] = "real",
    session: Session,
) -> ExitCode:
    """Emulate two Franka controllers over one simulated world, until Ctrl-C.

    They speak the vendor's protocol (libfranka) and refuse what a controller would refuse, by the
    vendor's error names. SIGUSR1 presses the stop button of both.

    Examples:
        minidual plant serve
        minidual plant serve --pace client
    """
    from minidual.plant.franka.cell import EmulatedCell
    from minidual.plant.franka.server import EmulatorServer, Pace
    from minidual.robot.pair import robot_from
    from minidual.tasks.catalogue import task_config

    if pace not in tuple(Pace):
        raise UsageError(f"no pace '{pace}'; there are {', '.join(Pace)}")
    config = task_config(session.loaded.config)
    addresses = tuple(host.strip() for host in hosts.split(",") if host.strip())
    try:
        cell = EmulatedCell(config.scene, robot_from(config.robot))
    except ValueError as error:
        raise UsageError(str(error), remedy="--set robot.arm=panda") from error
    server = EmulatorServer(cell, addresses, Pace(pace))
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: stop.set())
    session.say(f"emulator ready on {' and '.join(addresses)}; drive it with")
    session.say(f"  minidual env-check --plant franka://{','.join(addresses)}")
    try:
        server.run(stop)
    except KeyboardInterrupt:
        server.close()
    late = f"{server.late_ticks} of {cell.time_ms} milliseconds took longer"
    document = {"time_ms": cell.time_ms, "late_ticks": server.late_ticks, "exit_code": 0}
    session.finish(document, [f"emulator ended: {late}"])
    return ExitCode.PASS
