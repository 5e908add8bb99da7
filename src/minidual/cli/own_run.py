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
    """Switch to another run if the command would replace or outdate finished stages.

    It replaces those that it runs with other options. It outdates others that read a value which
    the run would remember. Stages that stay the same are hard-linked.

    Args:
        session: The command's; it goes on in the other run.
        names: Stages that the command asks for.
        options: {stage: its typed options}.
        force: Whether fresh stages run again.
    """
    _refuse_wrong_values(session, names, options, force)
    while True:
        gate = session.gate(options)
        replaced = gate.replaced(names, force) or outdated(session, names)
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


def outdated(session: Session, names: Sequence[str]) -> dict[str, str]:
    """Return the finished stages that values typed now make stale, if the run remembers them.

    Stages of the command and before it do not count: they run again, or close a gate.

    Args:
        session: The command's.
        names: Stages that the command asks for.

    Returns:
        {stage: the values that it read}.
    """
    if not session.common.settings and session.common.seed is None:
        return {}
    before = session.gate_before()
    now = session.gate()
    own = {stage for name in names for stage in (*session.table.upstream(name), name)}
    stale: dict[str, str] = {}
    for name in session.table:
        verdict = now.state(name).verdict
        if name in own or verdict is None or before.state(name).state not in ("pass", "fail"):
            continue
        choices = verdict.fingerprint.choices(now.fingerprint(name, verdict))
        if choices:
            stale[name] = "; ".join(choices)
    return stale


def say_outdated(session: Session, names: Sequence[str]) -> None:
    """Name the finished stages that values typed now make stale."""
    stale = outdated(session, names)
    if stale:
        session.say(f"stale with these values: {', '.join(stale)}", "yellow")


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
