"""The inputs of a stage: the artefacts that it reads, and the results of its upstream stages.

A stage whose row names its inputs stands on the content of these artefacts and of the upstream
verdicts, without times. An upstream stage that runs again and finds the same leaves it fresh. Any
other stage may read everything: it stands on the upstream verdicts byte for byte.
"""

from collections.abc import Mapping
from typing import NamedTuple

from minidual.gate.state import StageState
from minidual.gate.table import StageEntry
from minidual.gate.verdict import CONFIG_FILE


class Footing(NamedTuple):
    """The fields of the same names of `Fingerprint`."""

    inputs: dict[str, str]
    upstream: dict[str, str | None]


def footing(entry: StageEntry, upstream: Mapping[str, StageState]) -> Footing:
    """Return the present inputs of a row's stage; `upstream`: states of its upstream stages."""
    inputs: dict[str, str] = {}
    results: dict[str, str | None] = {}
    for name, state in upstream.items():
        if state.verdict is None or entry.inputs is None:
            results[name] = state.verdict_sha256
        else:
            results[name] = state.verdict.content()
        for path, sha256 in _artefacts(state).items():
            if entry.reads_artefact(name, path):
                inputs[f"{name}/{path}"] = sha256
    return Footing(inputs, results)


def _artefacts(state: StageState) -> dict[str, str]:
    """Return {path: sha256} of a stage's artefacts, without its configuration.

    That is part of its verdict.
    """
    if state.verdict is None:
        return {}
    return {
        path: artefact.sha256
        for path, artefact in state.verdict.artefacts.items()
        if path != CONFIG_FILE
    }
