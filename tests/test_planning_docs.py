"""The examples in the planning pages run, and their commands and example files exist."""

import re
from pathlib import Path

import numpy as np
import pytest

from minidual.stages.registry import STAGES

ROOT = Path(__file__).parents[1]


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["planning-scenes.md", "task-pipeline.md"])
def test_the_examples_run(name, capsys):
    (block,) = re.findall(r"```python\n(.*?)```", page(name), re.DOTALL)
    names = {}
    exec(block, names)
    if name == "planning-scenes.md":
        assert names["plan"].verification.ok
    else:
        carried = next(s.Ts_world_object for s in names["solution"].segments if s.Ts_world_object is not None)
        assert np.abs(carried[-1][:2, 3] - (0.5, -0.25)).max() < 1e-9
        assert "rod_carry: solved" in capsys.readouterr().out


def test_files_and_options_that_are_named_exist():
    text = page("planning-scenes.md")
    files = set(re.findall(r"examples/[\w.-]+", text))
    assert len(files) >= 3
    for file in files:
        assert (ROOT / file).is_file(), file
    known = {option.name for aside in STAGES["plan"].asides for option in aside.options}
    typed = set(re.findall(r"--([a-z][a-z-]*)", text)) - {"view", "json"}
    assert typed <= known
    assert known <= typed | set(re.findall(r"--([a-z][a-z-]*)", page("task-pipeline.md")))
