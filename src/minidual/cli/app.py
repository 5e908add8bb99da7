"""The command line: parse, call one stage, print. Heavy imports wait until a command runs."""

import inspect
from collections.abc import Iterable, Sequence
from dataclasses import fields
from functools import partial
from typing import Annotated, Any, get_type_hints

import typer

import minidual
from minidual.cli.commands import (
    Body,
    config_body,
    explain_body,
    run_body,
    run_stage,
    run_tool,
    status_body,
    stop_body,
)
from minidual.cli.session import OPTIONS, Session, Typed
from minidual.errors import UsageError, check_name
from minidual.gate.table import Option, StageTable, ToolEntry

_READING = ("status", "explain", "doctor", "report")
"""Commands that only read a run; the others begin one."""


def _parameters(options: Iterable[Option] = ()) -> list[inspect.Parameter]:
    """Return `options`, of which the last of a name counts, and those of every command as parameters."""
    found: dict[str, tuple[Any, Any]] = {}
    for option in options:
        kind: Any = str if option.kind is tuple else option.kind
        default, shown = (False, " ") if option.kind is bool else (None, option.metavar)
        if option.argument:
            default = None if option.optional else inspect.Parameter.empty
            declared: Any = typer.Argument(
                metavar=option.metavar or option.name.upper(),
                help=option.help,
            )
        else:
            declared = typer.Option(f"--{option.name}", metavar=shown, help=option.help)
        found[option.key] = (
            default,
            Annotated[kind if default is not None else kind | None, declared],
        )
    hints = get_type_hints(Typed, include_extras=True)
    found |= {field.name: (field.default, hints[field.name]) for field in fields(Typed)}
    return [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=annotation,
        )
        for name, (default, annotation) in found.items()
    ]


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"minidual {minidual.__version__}")
        raise typer.Exit


def build_app(table: StageTable, tools: Sequence[ToolEntry] = ()) -> typer.Typer:
    """Return the command line of stages and tools."""
    app = typer.Typer(
        name="minidual",
        help="From an empty folder to a measured dual-arm robot system. Each stage waits behind a gate.",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
        rich_markup_mode="rich",
    )
    config = typer.Typer(help="The resolved configuration.")
    watching = OPTIONS["watching"]
    running = OPTIONS["running"]

    def add(
        name: str,
        summary: str,
        examples: Sequence[str],
        body: Body,
        own: Iterable[Option],
        panel: str,
    ) -> None:
        parameters = _parameters(own)

        def command(**values: Any) -> None:
            session = Session(Typed(**{f.name: values.pop(f.name) for f in fields(Typed)}), table)
            raise typer.Exit(session.end(lambda s: body(s.begin(name in _READING), values)))

        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        epilog = "\n\n".join(["Examples:", *(f"minidual {example}" for example in examples)])
        owner = config if name == "show" else app
        owner.command(
            name,
            help=f"{summary}.",
            epilog=epilog if examples else None,
            rich_help_panel=panel,
        )(command)

    @app.callback()
    def root(  # pyright: ignore[reportUnusedFunction] - registered by the decorator
        version: Annotated[
            bool,
            typer.Option("--version", callback=_show_version, is_eager=True),
        ] = False,
    ) -> None:
        del version

    for entry in table.values():
        commands = (*entry.asides, entry)
        own = [option for command in commands for option in command.options]
        own += [*(watching if any(command.watchable for command in commands) else ()), *running]
        add(
            entry.name,
            entry.summary,
            entry.examples,
            partial(run_stage, entry),
            own,
            "Stages, in order",
        )
    bodies: dict[str, Body] = {
        "run": run_body,
        "status": status_body,
        "explain": explain_body,
        "stop": stop_body,
    }
    for name, body in {**bodies, "show": config_body}.items():
        own = (*OPTIONS.get(name, ()), *((*watching, *running) if name == "run" else ()))
        summary, _, *examples = inspect.cleandoc(body.__doc__ or "").splitlines()
        add(name, summary.rstrip("."), examples, body, own, "The run")
    app.add_typer(config, name="config", rich_help_panel="The run")
    for tool in tools:
        own = (*tool.options, *(watching if tool.watchable else ()))
        add(
            tool.name,
            tool.summary,
            tool.examples,
            partial(run_tool, tool),
            own,
            "Tools, without gate and verdict",
        )
    return app


def run_command_line(
    arguments: Sequence[str],
    table: StageTable,
    tools: Sequence[ToolEntry] = (),
) -> int:
    """Run one command and return its exit code."""
    first = arguments[0].split("=")[0] if arguments else "--help"

    def parse(_session: Session) -> int:
        if strange := [word for word in arguments if word.encode(errors="ignore").decode() != word]:
            raise UsageError(f"{strange[0]} is not UTF-8")
        table.plug_in("minidual.stages")
        app = build_app(table, tools)
        commands = {command.name or "" for command in app.registered_commands} | {"config"}
        if first in {"--set", *(f"--{f.name.replace('_', '-')}" for f in fields(Typed))}:
            raise UsageError(f"{first} stands after the command: minidual COMMAND {first} ...")
        if not first.startswith("-"):
            check_name("command", first, commands)
        try:
            return app([*arguments] or ["--help"], prog_name="minidual", standalone_mode=False)
        except typer.TyperException as error:
            remedy = f"minidual {first if first in commands else ''} --help".replace("  ", " ")
            raise UsageError(error.format_message(), remedy=remedy) from error

    return Session(Typed(json="--json" in arguments), table).end(parse)
