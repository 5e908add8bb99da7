"""Commands of stages and tools that are only rows: those of other distributions.

See docs/howto-stage.md. The commands of this package are functions in `minidual.cli.commands`.
"""

import inspect
from collections.abc import Iterable, Sequence
from typing import Annotated, Any

import typer

from minidual.cli.execute import Aside, run_stage, run_tool
from minidual.cli.options import GateOptions, ViewOptions, flag
from minidual.cli.session import Session
from minidual.cli.signature import Command
from minidual.errors import ExitCode
from minidual.gate.table import Option, StageEntry, ToolEntry


def stage_command(entry: StageEntry) -> Command:
    """Return the command of a stage, with the options that its row and its asides' rows list."""
    rows = (*entry.asides, entry)

    def command(
        *,
        session: Session,
        gate_options: GateOptions,
        view_options: ViewOptions | None = None,
        **values: Any,
    ) -> ExitCode:
        asides = [
            Aside(aside.name, aside.trigger, _values_of(aside.options, values))
            for aside in entry.asides
        ]
        return run_stage(
            session,
            entry.name,
            _values_of(entry.options, values),
            gate_options,
            view_options or ViewOptions(),
            asides,
        )

    groups: dict[str, type] = {"gate_options": GateOptions, "session": Session}
    if any(row.watchable for row in rows):
        groups = {"view_options": ViewOptions, **groups}
    options = [option for row in rows for option in row.options]
    return _described(command, options, groups, entry.summary, entry.examples)


def tool_command(tool: ToolEntry) -> Command:
    """Return the command of a tool, with the options that its row lists."""

    def command(
        *,
        session: Session,
        view_options: ViewOptions | None = None,
        **values: Any,
    ) -> ExitCode:
        options = _values_of(tool.options, values)
        return run_tool(session, tool, options, view_options or ViewOptions())

    groups: dict[str, type] = {"session": Session}
    if tool.watchable:
        groups = {"view_options": ViewOptions, **groups}
    return _described(command, tool.options, groups, tool.summary, tool.examples)


def _values_of(options: Iterable[Option], values: dict[str, Any]) -> dict[str, Any]:
    return {option.name: values[option.key] for option in options}


def _described(
    command: Command,
    options: Iterable[Option],
    groups: dict[str, type],
    summary: str,
    examples: Sequence[str],
) -> Command:
    """Give `command` the signature and docstring that a function written by hand has.

    Args:
        command: Takes the options by their keys.
        options: Of options with one name, the last counts.
        groups: {parameter: its group of options}.
        summary: Help without the final full stop.
        examples: Commands without "minidual".
    """
    own = {option.key: _parameter(option) for option in options}
    shared = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=group)
        for name, group in groups.items()
    ]
    parameters = [*own.values(), *shared]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    command.__doc__ = f"{summary}."
    if examples:
        lines = "\n".join(f"    minidual {example}" for example in examples)
        command.__doc__ += f"\n\nExamples:\n{lines}"
    return command


def _parameter(option: Option) -> inspect.Parameter:
    if option.kind is bool:
        default = False
        annotation: Any = Annotated[bool, flag(f"--{option.name}", option.help)]
    else:
        default = None
        kind = str if option.kind is tuple else option.kind
        declaration = typer.Option(f"--{option.name}", help=option.help)
        annotation = Annotated[kind | None, declaration]
    return inspect.Parameter(
        option.key,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=annotation,
    )
