"""Recorded signals that a policy reads beside joints and pictures (`train.inputs`)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minidual.demos.lerobot_reader import has_signal, read_signal
from minidual.demos.schema import SIGNALS
from minidual.demos.sensed import SENSED
from minidual.errors import DataError, UsageError


def read_input(root: Path, name: str) -> NDArray[np.float32]:
    """Return a recorded signal (N, entries) that a policy is to read.

    Raises:
        DataError: The dataset has it not, or it is not finite.
        UsageError: No policy senses it.
    """
    if name in SIGNALS and name not in SENSED:
        raise UsageError(
            f"train.inputs: a policy cannot sense '{name}'; of what is recorded it can sense "
            f"{', '.join(SENSED)}",
        )
    values = read_signal(root, name)
    if values is None:
        recorded = [each for each in SENSED if has_signal(root, each)]
        raise DataError(
            f"the dataset {root} holds no signal '{name}', which train.inputs asks for; "
            f"it holds {', '.join(recorded) or 'none'}",
            remedy=signals_remedy([name]),
        )
    if not np.isfinite(values).all():
        raise DataError(f"{root}: the signal '{name}' is not finite in every tick")
    return values


def signals_remedy(names: Sequence[str]) -> str:
    """Return what to type so that recordings hold signals."""
    return (
        f"record it: minidual teleop-record --force --set 'teleop.signals=[{', '.join(names)}]', "
        "and give the same --set to train-act"
    )
