"""Compiled loops: where no cache can be written, what else fails, and what they are given."""

import subprocess
import sys

import numpy as np
import pytest
from numba.core.errors import NumbaError

from minidual.collision.scene import PlanningScene
from minidual.motion.search import EdgeChecker
from minidual.proof import planes
from minidual.proof.scene_engines import SceneEngines
from minidual.robot import compiled
from minidual.skills import object_kernels
from tests.support.panda import HOME


def test_without_a_place_for_the_cache_it_compiles_in_memory(monkeypatch):
    calls = []

    def njit(signature, *, cache=False, **options):
        calls.append(cache)
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda law: law

    monkeypatch.setattr(compiled, "njit", njit)
    assert compiled.kernel("signature")(len) is len
    assert calls == [True, False]


def test_another_failure_of_the_compiler_is_not_hidden(monkeypatch):
    def njit(signature, **options):
        raise RuntimeError("something else")

    monkeypatch.setattr(compiled, "njit", njit)
    with pytest.raises(RuntimeError, match="something else"):
        compiled.kernel("signature")(len)


def test_what_compiled_code_takes_is_made_of_anything():
    rows = np.arange(12.0).reshape(3, 4)
    rows.setflags(write=False)
    for given in (rows, rows[:, ::2], rows.astype(np.float32), rows.astype(int)):
        taken = compiled.floats(given)
        assert np.array_equal(taken, given)
        assert taken.dtype == float
        assert taken.flags.c_contiguous
        assert taken.flags.writeable
    own = np.zeros(3)
    assert compiled.floats(own) is own


def test_the_private_flag_of_numba_is_still_there():
    """Without it planning is five times slower: say so here when a numba drops the name."""
    assert compiled.UNCOUNTED == {"_nrt": False}


def test_a_kernel_that_counts_no_references_checks_its_arguments_all_the_same():
    a = np.arange(3.0)
    b = np.array([0.0, 3.0, 2.0])
    before = sys.getrefcount(a)
    for _ in range(1000):
        assert object_kernels.farthest(a, b) == 2.0
    assert sys.getrefcount(a) == before
    for wrong in (b.astype(np.float32), b.reshape(1, 3), np.zeros(6)[::2], b.tolist()):
        with pytest.raises(TypeError):
            object_kernels.farthest(a, wrong)


def test_a_kernel_that_makes_arrays_must_say_so():
    kind = compiled.VECTOR(compiled.VECTOR)
    assert compiled.kernel(kind, heap=True)(lambda a: a + a)(np.ones(2)).tolist() == [2.0, 2.0]
    with pytest.raises(NumbaError):
        compiled.kernel(kind)(lambda a: a - 1.0)


def test_numba_loads_without_scipy_linalg_and_still_multiplies_matrices():
    """A numba that drops the private name, or imports SciPy elsewhere, shows here."""
    program = """
import sys
import minidual.robot.compiled
from numba.np import arraymath
print("scipy.linalg" in sys.modules, "_HAVE_BLAS" in Path(arraymath.__file__).read_text())
import numpy as np
from numba import njit
print(njit(lambda a: a @ a)(2.0 * np.eye(2))[1, 1])
"""
    done = subprocess.run(
        [sys.executable, "-c", f"from pathlib import Path{program}"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["False", "True", "4.0"]


def test_no_caller_makes_the_planes_compile_again():
    """Every entry makes arrays of one kind: another kind would compile for ten seconds."""
    engines = SceneEngines(PlanningScene())
    checker = EdgeChecker(engines, 0.008, (HOME,), 0.05)
    both = np.array([HOME, HOME + 0.01])
    for Q in (both, both[:, ::-1][:, ::-1], np.asfortranarray(both), both.astype(np.float32)):
        assert checker.all_free(Q)
        assert engines.solids.clearance(Q, 0.04) > 0.0
    assert checker.free(HOME)
    assert EdgeChecker(engines, 0.008, (), 0.05).free(HOME)
    assert len(planes._survey.signatures) == 1
    assert len(planes._clearance.signatures) == 1
