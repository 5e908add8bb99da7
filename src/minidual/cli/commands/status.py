"""`minidual status`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from minidual.cli.console import print_lowest, print_status
from minidual.cli.documents import state_document
from minidual.cli.session import Session
from minidual.errors import ExitCode
from minidual.gate.lock import LOCK_FILE, held_by
from minidual.gate.signature import unverified


def status(
    *,
    key: Annotated[
        Path | None,
        typer.Option(
            "--verify",
            metavar="KEY",
            help="Verify the signature with this .pub file.",
        ),
    ] = None,
    session: Session,
) -> ExitCode:
    """Show which stages pass, are stale, missing or blocked, and why.

    Examples:
        minidual status
        minidual status --profile smoke --json
        minidual status --verify ~/.ssh/id_ed25519.pub
    """
    return show_status(session, explained=False, key=key)


def show_status(session: Session, *, explained: bool, key: Path | None = None) -> ExitCode:
    """Print every stage's state; `explained` adds what to look at first."""
    gate = session.gate()
    store = session.store
    differences = None if key is None else unverified(gate, key)
    following = session.following(gate, explained=explained)
    lowest = gate.lowest()
    holder = held_by(store.folder / LOCK_FILE)
    writer = None if holder is None else holder[1]
    if not session.common.json:
        title = f"run {store.run} (profile {session.loaded.profile}, {store.folder})"
        print_status(session.data, gate, title, "" if explained else following)
        if explained:
            print_lowest(session.data, lowest, following, session.in_this_run)
        session.say_remembered()
        if writer is not None:
            session.say(f"being written by {writer}")
    if differences is not None:
        _say_signature(session, differences)
    document: dict[str, Any] = {
        "run": store.run,
        "folder": store.folder,
        "profile": session.loaded.profile,
        "remembered": session.remembered,
        "writer": writer,
        "stages": [state_document(gate.state(name)) for name in session.table],
        "lowest": None if lowest is None else lowest.name,
        "because": () if lowest is None else lowest.because(),
        "next": following,
        "signature": None if key is None else {"key": key, "changed": differences},
    }
    session.finish(document, ())
    return ExitCode.ACCEPTANCE_FAILED if differences else ExitCode.PASS


def _say_signature(session: Session, differences: list[str]) -> None:
    if not differences:
        session.say("signature: the verdicts and artefacts are as signed", "green")
    for line in differences:
        session.say(f"signature: {line}", "bold red")
