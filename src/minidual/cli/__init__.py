"""The command line: parse, call one stage, print. Heavy imports wait until a command runs."""

from __future__ import annotations

import inspect
import signal
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

import minidual
from minidual.cli.commands import Body, config_body, explain_body, run_body, stage_body, status_body, tool_body
from minidual.cli.session import Session, Typed
from minidual.cli.viewing import VIEW_OPTIONS
from minidual.errors import ExitCode, UsageError, unknown_name
from minidual.gate.table import Option, StageEntry, StageTable, ToolEntry

_COMMON: dict[str, tuple[Any, Any]] = {
    "profile": (
        Annotated[str, typer.Option(help="smoke, standard, gpu, or a profile file ending in .yaml.")],
        "standard",
    ),
    "settings": (
        Annotated[
            list[str] | None,
            typer.Option("--set", metavar="KEY=VALUE", help="Override a configuration value, e.g. plan.queries_n=30."),
        ],
        None,
    ),
    "run": (Annotated[str | None, typer.Option(help="Name of the run (default: the profile's name).")], None),
    "runs_dir": (
        Annotated[Path | None, typer.Option(help="Folder of all runs (default: $MINIDUAL_RUNS or ./runs).")],
        None,
    ),
    "seed": (Annotated[int | None, typer.Option(help="The one seed of the run.")], None),
    "workers": (Annotated[int | None, typer.Option(help="Processes to use; results do not depend on it.")], None),
    "json": (Annotated[bool, typer.Option("--json", help="Print one JSON document to stdout.")], False),
    "debug": (Annotated[bool, typer.Option("--debug", help="Show tracebacks.")], False),
}
_FORCE = (Annotated[bool, typer.Option("--force", help="Run even if fresh. Never opens a gate.")], False)
_WAIVE = (
    Annotated[
        str | None,
        typer.Option(metavar="REASON", help="Open a closed gate; written down, taints everything downstream."),
    ],
    None,
)
_RUNNING: dict[str, tuple[Any, Any]] = {"force": _FORCE, "waive_gate": _WAIVE}


def _add(
    app: typer.Typer, table: StageTable, name: str, summary: str, own: Mapping[str, tuple[Any, Any]], body: Body
) -> None:
    """Add a command with `own` and common options ({name: (annotation, default)})."""
    options = {**own, **_COMMON}

    def command(**values: Any) -> None:
        common = {key: values[key] for key in _COMMON}
        common["settings"] = tuple(common["settings"] or ())
        session = Session(Typed(**common), table)
        raise typer.Exit(session.end(lambda s: body(s, {key: values[key] for key in own})))

    command.__doc__ = summary
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for key, (annotation, default) in options.items()
        ]
    )
    command.__annotations__ = {key: annotation for key, (annotation, _) in options.items()}
    app.command(name, help=summary)(command)


def _typed(option: Option) -> tuple[Any, Any]:
    if option.argument:
        kind: Any = list[option.kind] if option.many else option.kind
        argument = typer.Argument(metavar=option.name.upper(), help=option.help)
        return (
            (Annotated[kind, argument], inspect.Parameter.empty)
            if option.required
            else (Annotated[kind | None, argument], None)
        )
    if option.kind is bool:
        return Annotated[bool, typer.Option(f"--{option.name}", help=option.help)], False
    return Annotated[option.kind | None, typer.Option(f"--{option.name}", help=option.help)], None


def _stage_options(entry: StageEntry) -> dict[str, tuple[Any, Any]]:
    """Return the options of a stage and its asides; the stage's take precedence."""
    asides = [option for aside in entry.asides for option in aside.options]
    return {option.key: _typed(option) for option in (*asides, *entry.options)}


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"minidual {minidual.__version__}")
        raise typer.Exit


def _flag(name: str) -> str:
    return "--set" if name == "settings" else f"--{name.replace('_', '-')}"


def build_app(table: StageTable, tools: Sequence[ToolEntry] = ()) -> typer.Typer:
    """Return the command line of the stages and tools."""
    app = typer.Typer(
        name="minidual",
        help="From an empty folder to a measured dual-arm robot system. Each command is a stage behind a gate.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )

    @app.callback()
    def root(  # pyright: ignore[reportUnusedFunction] - registered by the decorator
        version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True)] = False,
    ) -> None:
        del version

    for entry in table:
        watchable = entry.watchable or any(aside.watchable for aside in entry.asides)
        own = {**_stage_options(entry), **(VIEW_OPTIONS if watchable else {}), **_RUNNING}
        _add(app, table, entry.name, f"{entry.summary}.", own, stage_body(entry))
    for tool in tools:
        options = {option.key: _typed(option) for option in tool.options}
        options |= VIEW_OPTIONS if tool.watchable else {}
        _add(app, table, tool.name, f"{tool.summary}.", options, tool_body(tool))
    until = (Annotated[str | None, typer.Option(metavar="STAGE", help="Last stage to run.")], None)
    _add(
        app,
        table,
        "run",
        "Run every stage that is not passing and fresh, in order.",
        {"until": until, **VIEW_OPTIONS, **_RUNNING},
        run_body,
    )
    _add(app, table, "status", "Show where every stage of the run stands.", {}, status_body)
    stage = (Annotated[str | None, typer.Argument(help="Name of a stage; none walks the debug ladder.")], None)
    _add(
        app,
        table,
        "explain",
        "Explain one stage: checks, margins, remedies, staleness, requirements; or what to look at first.",
        {"stage": stage},
        explain_body,
    )
    config = typer.Typer(help="The resolved configuration.", no_args_is_help=True, rich_markup_mode=None)
    _add(config, table, "show", "Print the resolved configuration as YAML.", {}, config_body)
    app.add_typer(config, name="config")
    return app


def run_command_line(arguments: Sequence[str], table: StageTable, tools: Sequence[ToolEntry] = ()) -> int:
    """Run one command and return its exit code."""
    app = build_app(table, tools)
    commands = {command.name or "" for command in app.registered_commands} | {"config"}
    if arguments and arguments[0].split("=")[0] in {_flag(name) for name in _COMMON}:
        flag = arguments[0].split("=")[0]
        print(f"minidual: {flag} stands after the command: minidual COMMAND {flag} ...", file=sys.stderr)
        return int(ExitCode.USAGE)
    if arguments and not arguments[0].startswith("-") and arguments[0] not in commands:
        error = unknown_name("command", arguments[0], commands)
        print(f"minidual: {error}", file=sys.stderr)
        return int(error.exit_code)
    try:
        app(list(arguments), prog_name="minidual")
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(ExitCode.PASS)
    except KeyboardInterrupt:
        print("minidual: interrupted", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    return int(ExitCode.PASS)


def _on_termination(number: int, frame: FrameType | None) -> None:
    """Treat SIGTERM and SIGHUP (the terminal was closed) like Ctrl-C."""
    raise KeyboardInterrupt


def main() -> None:
    """Entry point of the `minidual` command."""
    from minidual.stages.registry import STAGES, TOOLS

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _on_termination)
    # Some libraries' docstrings hold invalid escapes, which warn when compiled.
    warnings.simplefilter("ignore", SyntaxWarning)
    try:
        STAGES.plug_in("minidual.stages")
    except UsageError as error:
        print(f"minidual: {error}", file=sys.stderr)
        sys.exit(int(error.exit_code))
    sys.exit(run_command_line(sys.argv[1:], STAGES, TOOLS))
