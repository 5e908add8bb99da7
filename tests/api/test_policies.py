"""Policies from Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.api.policies import load_policy
from minidual.errors import UsageError


@pytest.mark.torch
def test_the_policy_of_the_package_acts_within_limits() -> None:
    policy = load_policy("rod_carry")
    images = {name: np.full((*size, 3), 120, np.uint8) for name, size in policy.cameras.items()}
    chunk = policy.predict_chunk(images, np.zeros(16))
    assert chunk.shape == (policy.policy.chunk_size, 16)
    assert np.isfinite(chunk).all()


def test_a_folder_without_a_policy_is_refused_with_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no policy .*\(rod_carry\)"):
        load_policy(tmp_path)
    with pytest.raises(UsageError, match="no policy 'sort'"):
        load_policy("sort")
