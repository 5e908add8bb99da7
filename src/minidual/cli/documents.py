"""Parts of the JSON documents that commands print."""

from typing import Any

from minidual.gate.runner import StageOutcome
from minidual.gate.state import StageState


def outcome_document(outcome: StageOutcome) -> dict[str, Any]:
    """Return a stage's state after a command, with its verdict."""
    return {
        "stage": outcome.state.name,
        "ran": outcome.ran,
        **state_document(outcome.state),
        "verdict": outcome.verdict.to_json(),
    }


def state_document(state: StageState) -> dict[str, Any]:
    """Return a stage's state, with what its verdict says in short."""
    verdict = state.verdict
    document: dict[str, Any] = {
        "name": state.name,
        "state": state.state,
        "reasons": state.reasons,
        "warnings": state.warnings,
        "folder": state.folder,
        "status": None,
        "acceptance": False,
        "failed": [],
        "weakened": (),
        "waivers": [],
    }
    if verdict is not None:
        document["status"] = verdict.status
        document["acceptance"] = verdict.acceptance
        document["failed"] = [check.to_json() for check in verdict.failed_checks()]
        document["weakened"] = verdict.weakened
        document["waivers"] = [waiver.reason for waiver in verdict.waivers]
    return document
