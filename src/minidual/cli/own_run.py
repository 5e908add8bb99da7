"""A run of its own for a command that would replace finished work."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from minidual.cli.options import CommonOptions
from minidual.cli.session import Session
from minidual.gate.canonical import digest
from minidual.gate.gate import Gate

_NAME_LENGTH_MAX = 80


def spare_finished(
    session: Session,
    names: Sequence[str],
    options: Mapping[str, Mapping[str, Any]],
    force: bool,
) -> None:
    """Switch to another run if the command would replace stages finished with other options.

    Stages that stay the same are hard-linked.

    Args:
        session: The command's; it goes on in the other run.
        names: Stages that the command asks for.
        options: {stage: its typed options}.
        force: Whether fresh stages run again.
    """
    _refuse_wrong_values(session, names, options, force)
    while True:
        gate = session.gate(options)
        replaced = gate.replaced(names, force)
        if not replaced:
            return
        base = session.store
        own = own_run(session.common, base.run, options.values())
        session.work_in(own)
        first, *others = replaced
        more = f" (and of {', '.join(others)})" if others else ""
        session.say(f"run '{base.run}' keeps its finished {first}{more}: {replaced[first]}")
        session.say(f"working in run '{own}' instead; --yes would replace it in '{base.run}'")
        for name in _kept(gate, names, force):
            session.store.link(name, base)


def _refuse_wrong_values(
    session: Session,
    names: Sequence[str],
    options: Mapping[str, Mapping[str, Any]],
    force: bool,
) -> None:
    """Raise UsageError for a misspelt value: no other run is begun for it."""
    gate = session.gate(options)
    for name in gate.rerun(names, force):
        config = gate.effective(name, None)[1].config
        session.table[name].resolved(config, checked=True)


def _kept(gate: Gate, names: Sequence[str], force: bool) -> list[str]:
    """Return the finished stages that the command needs and does not run again."""
    needed = {upstream for name in names for upstream in (*gate.table.upstream(name), name)}
    needed -= {*gate.rerun(names, force)}
    # A failed stage counts as finished: a waiver works on it.
    return [
        name for name in gate.table if name in needed and gate.state(name).state in ("pass", "fail")
    ]


def own_run(common: CommonOptions, run: str, options: Iterable[Mapping[str, Any]]) -> str:
    """Return the name of a run beside `run` that says what was typed; at most 80 characters."""
    words: list[str] = []
    if common.profile != "standard" and common.run is not None:
        words.append(Path(common.profile).stem)
    for values in options:
        for name, value in values.items():
            words.append(value if isinstance(value, str) else f"{name}-{value}")
    words += [setting.replace("=", "-") for setting in common.settings or ()]
    if common.seed is not None:
        words.append(f"seed-{common.seed}")
    name = "-".join([run, *(words or ["defaults"])])
    name = re.sub(r"[^A-Za-z0-9._]+", "-", name).strip("-")
    if len(name) <= _NAME_LENGTH_MAX:
        return name
    return f"{name[:71]}-{digest([run, *words])[:8]}"
