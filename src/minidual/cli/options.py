"""Options that several commands share.

A command function takes one of these classes as a parameter; on the command line its fields are
options (`minidual.cli.signature`).
"""

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import typer

_common = partial(typer.Option, rich_help_panel="Every command")


def flag(name: str, text: str) -> Any:
    """Return the declaration of a flag: no `--no-` form, and no type in the help."""
    return typer.Option(name, metavar=" ", help=text)


PlantAddress = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="sim, sim-position, franka://HOST,HOST or MODULE:FACTORY (default: sim).",
    ),
]
"""Type of the option --plant: what is driven, None for the configuration's."""


@dataclass(frozen=True)
class CommonOptions:
    """Options of every command."""

    profile: Annotated[
        str,
        _common(help="smoke, standard, gpu, or a profile file ending in .yaml."),
    ] = "standard"
    settings: Annotated[
        list[str] | None,
        _common(
            "--set",
            metavar="KEY=VALUE",
            help="Override a configuration value, e.g. plan.queries_n=30; the run remembers it.",
        ),
    ] = None
    run: Annotated[
        str | None,
        _common(help="Name of the run (default: the profile's name)."),
    ] = None
    runs_dir: Annotated[
        str | None,
        _common(metavar="DIR", help="Folder of all runs (default: $MINIDUAL_RUNS or ./runs)."),
    ] = None
    seed: Annotated[int | None, _common(help="The one seed of the run.")] = None
    workers: Annotated[
        int | None,
        _common(help="Processes to use; results do not depend on it."),
    ] = None
    json: Annotated[
        bool,
        _common("--json", metavar=" ", help="Print one JSON document to stdout."),
    ] = False
    debug: Annotated[bool, _common("--debug", metavar=" ", help="Show tracebacks.")] = False

    def command(self, words: str) -> str:
        """Return "minidual <words>" with `flags`."""
        return f"minidual {words}{self.flags}"

    @property
    def flags(self) -> str:
        """The typed options that select run and result, after a space; "" if none was typed."""
        options: list[tuple[str, str | int | None]] = [("--seed", self.seed)]
        options += [("--set", setting) for setting in self.settings or ()]
        return self.place + _joined(options)

    @property
    def place(self) -> str:
        """The typed options that select the run, like `flags`."""
        return _joined(
            [
                ("--profile", None if self.profile == "standard" else self.profile),
                ("--run", self.run),
                ("--runs-dir", self.runs_dir),
            ],
        )


def _joined(options: Iterable[tuple[str, str | int | None]]) -> str:
    return "".join(
        f" {name} {shlex.quote(str(value))}" for name, value in options if value is not None
    )


@dataclass(frozen=True)
class ViewOptions:
    """Options of commands that show moving arms. They never change a verdict."""

    view: Annotated[
        str | None,
        typer.Option(metavar="none|web", help="Watch the arms in a browser."),
    ] = None
    view_host: Annotated[
        str | None,
        typer.Option(
            help="Interface for --view web (default 127.0.0.1: this machine and ssh tunnels only).",
        ),
    ] = None
    view_port: Annotated[
        int | None,
        typer.Option(help="First port to try for --view web (default 8080)."),
    ] = None


@dataclass(frozen=True)
class GateOptions:
    """Options of commands that run stages."""

    force: Annotated[bool, flag("--force", "Run even if fresh. Never opens a gate.")] = False
    waive_gate: Annotated[
        str | None,
        typer.Option(
            metavar="REASON",
            help="Open a closed gate; the reason is recorded, "
            "and nothing built on it counts as acceptance.",
        ),
    ] = None
    yes: Annotated[
        bool,
        flag("--yes", "Replace finished stages that were run with other options."),
    ] = False
