"""Turn command functions into functions that Typer reads.

A command is a plain function with typed keyword parameters. A parameter of one of the types below
stands for a group of options: Typer gets its fields instead, and the function the filled group.
"""

import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints

from minidual.cli.options import CommonOptions, GateOptions, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode

Command = Callable[..., ExitCode]
"""Runs one command. Its docstring is the help: a text, then "Examples:" and one command a line."""

_GROUPS: dict[type, type] = {
    ViewOptions: ViewOptions,
    GateOptions: GateOptions,
    Session: CommonOptions,
}
"""{type of a parameter: options that it stands for}. A session is made from the common options."""


def help_and_examples(command: Command) -> tuple[str, list[str]]:
    """Return the help text and the example commands of a docstring."""
    text, _, examples = inspect.cleandoc(command.__doc__ or "").partition("\n\nExamples:\n")
    return text, [line.strip() for line in examples.splitlines() if line.strip()]


def typer_function(
    command: Command,
    run: Callable[[CommonOptions, Callable[[Session], int]], None],
) -> Callable[..., None]:
    """Return a function with one parameter for each option of `command`.

    Args:
        command: Its parameter of type `Session` is required.
        run: Makes the session and calls the command with it.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        group = _GROUPS.get(hints[name])
        if group is None:
            parameters.append(parameter.replace(annotation=hints[name]))
        else:
            groups[name] = group
            parameters += _parameters(group)
    session_name = next(name for name, group in groups.items() if group is CommonOptions)

    def function(**values: Any) -> None:
        arguments = dict(values)
        for name, group in groups.items():
            arguments[name] = group(**{f.name: arguments.pop(f.name) for f in fields(group)})
        common = arguments.pop(session_name)
        run(common, lambda session: command(**arguments, **{session_name: session}))

    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {p.name: p.annotation for p in parameters}
    return function


def _parameters(group: type) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]
