"""The reference of the command line, from the Typer app."""

import inspect
from typing import Any

import typer

from minidual.cli.app import build_app
from minidual.stages.registry import STAGES, TOOLS

_SHARED_PANEL = "Every command"


def command_reference() -> str:
    """Return the page of all commands with their options."""
    group: Any = typer.main.get_command(build_app(STAGES, TOOLS))
    commands = _flat(group)
    shared = next(iter(commands.values())).params
    about = (
        "Made from the program's own `--help`. Options stand after the command:"
        " `minidual COMMAND --option value`."
    )
    lines = [
        "# Command line",
        "",
        about,
        "",
        "## Options of every command",
        "",
        *_table([option for option in shared if _is_shared(option)]),
    ]
    for name, command in commands.items():
        lines += ["", *_command(name, command)]
    return "\n".join(lines) + "\n"


def _flat(group: Any, before: str = "") -> dict[str, Any]:
    """Return {words: command} of a group and of the groups in it."""
    commands: dict[str, Any] = {}
    for name, command in group.commands.items():
        words = f"{before}{name}"
        if hasattr(command, "commands"):
            commands |= _flat(command, f"{words} ")
        else:
            commands[words] = command
    return commands


def _is_shared(parameter: Any) -> bool:
    return getattr(parameter, "rich_help_panel", None) == _SHARED_PANEL


def _command(name: str, command: Any) -> list[str]:
    own = [parameter for parameter in command.params if not _is_shared(parameter)]
    arguments = [p for p in own if p.param_type_name == "argument"]
    options = [p for p in own if p.param_type_name == "option" and not getattr(p, "hidden", False)]
    words = [p.name.upper() if p.required else f"[{p.name.upper()}]" for p in arguments]
    usage = " ".join(["minidual", name, *words, "[OPTIONS]"])
    lines = [f"## minidual {name}", "", inspect.cleandoc(command.help or ""), ""]
    lines += ["```text", usage, "```"]
    if arguments or options:
        lines += ["", *_table([*arguments, *options])]
    examples = [line for line in (command.epilog or "").splitlines() if line][1:]
    if examples:
        lines += ["", "Examples:", "", "```sh", *examples, "```"]
    return lines


def _table(parameters: list[Any]) -> list[str]:
    rows = ["| option | value | meaning |", "|---|---|---|"]
    for parameter in parameters:
        meaning = _cell(parameter.help or "")
        default = parameter.default
        if isinstance(default, int | float | str) and not isinstance(default, bool):
            meaning += f" Default: `{default}`."
        rows.append(f"| {_names(parameter)} | {_value(parameter)} | {meaning} |")
    return rows


def _names(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return f"`{parameter.name.upper()}`"
    return ", ".join(f"`{name}`" for name in parameter.opts)


def _value(parameter: Any) -> str:
    """Return the metavar or type of a parameter, "" for a flag."""
    if getattr(parameter, "is_flag", False):
        return ""
    if parameter.param_type_name == "option" and parameter.metavar:
        return f"`{parameter.metavar.strip()}`"  # in code, a bar separates no cells
    annotation = parameter.type_descriptor.annotation
    return {str: "text", int: "integer", float: "number"}.get(annotation, "text")


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ").strip()
