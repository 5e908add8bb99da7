"""The exported workspace of two Pandas, written once."""

from __future__ import annotations

from pathlib import Path

import pytest

from minidual.config.root import Config
from minidual.robot.pair import DUAL_PANDA
from minidual.ros2.export.workspace import Export, export_workspace


@pytest.fixture(scope="session")
def panda_export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    return export_workspace(DUAL_PANDA, Config(), tmp_path_factory.mktemp("ros2") / "ws")


@pytest.fixture(scope="session")
def workspace(panda_export: Export) -> Path:
    return panda_export.folder
