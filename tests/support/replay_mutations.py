"""Seeded mutations of a recording's arrays and header, and `minidual replay` of one file."""

import contextlib
import io
import json

import numpy as np

from minidual.plant import recording

ODD = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 9.0, 1e-300, 2.0**31, 0.5, 1e10, -1e9)
VALUES = (None, "x", -1, 1e300, 0, [], {}, "\x1b[2J", True, [1, 2], 1e9, float("nan"), 2**70)
TYPES = (np.int32, np.float32, np.complex128, "S8", ">f8", bool)


def mutate(arrays, seed):
    """Return the arrays with one changed, and what was changed."""
    rng = np.random.default_rng(seed)
    name = rng.choice(sorted(set(arrays) - {"digest"}))
    values = arrays[name].copy()
    how = rng.integers(8)
    if name == "header":
        values, what = _other_header(values, rng)
    elif how < 4 and values.size:
        odd = ODD[rng.integers(len(ODD))]
        flat = values.reshape(-1)
        where = rng.integers(flat.size)
        flat[where] = odd if values.dtype.kind == "f" or abs(odd) < 2**62 else -(2**63)
        values = flat.reshape(values.shape)
        what = f"[{where}] = {odd}"
    elif how == 4:
        values = np.full_like(
            values,
            ODD[rng.integers(3, len(ODD))] if values.dtype.kind == "f" else 7,
        )
        what = "filled"
    elif how == 5:
        values = values[..., None]
        what = "one more dimension"
    elif how == 6:
        with np.errstate(all="ignore"):
            values = values.astype(TYPES[rng.integers(len(TYPES))])
        what = str(values.dtype)
    else:
        values = values[: len(values) // 2] if values.ndim else values * 2
        what = "half"
    return arrays | {name: values}, f"{name} {what}"


def _other_header(values, rng):
    header = node = json.loads(values.tobytes())
    parent = header
    key = "kind"
    while isinstance(node, dict | list) and node:
        key = rng.choice(sorted(node)) if isinstance(node, dict) else int(rng.integers(len(node)))
        parent = node
        node = node[key]
        if rng.random() < 0.1:
            break
    value = VALUES[rng.integers(len(VALUES))]
    parent[key] = value
    return np.frombuffer(json.dumps(header).encode(), np.uint8), f"{key} = {value!r}"


def write(path, arrays, *, forged):
    """Write the arrays, with a digest that fits them if `forged`."""
    if forged:
        arrays = arrays | {
            "digest": recording._digest({n: v for n, v in arrays.items() if n != "digest"}),
        }
    np.savez(path, **arrays)


def run(path):
    """Return exit code and output of `minidual replay`."""
    from minidual.cli.app import run_command_line
    from minidual.stages.registry import STAGES, TOOLS

    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
        code = run_command_line(["replay", str(path), "--runs-dir", f"{path}.runs"], STAGES, TOOLS)
    return code, out.getvalue()
