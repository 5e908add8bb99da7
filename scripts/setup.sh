#!/usr/bin/env bash
# Build .venv: Python 3.12, the locked dependencies by hash, and minidual itself in editable form.
# `make setup` runs this once, and again whenever requirements.lock or pyproject.toml changes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
venv=.venv
lock=requirements.lock

is_312() {
    "$1" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12) or sys.implementation.name != "cpython")' \
        >/dev/null 2>&1
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        is_312 "$PYTHON" && echo "$PYTHON" && return
        echo "PYTHON=$PYTHON is not CPython 3.12 ($("$PYTHON" --version 2>&1 | head -n 1 || true))" >&2
        return 1
    fi
    local name seen=""
    for name in python3.12 python3 python; do
        command -v "$name" >/dev/null 2>&1 || continue
        is_312 "$name" && echo "$name" && return
        seen="$seen $name ($("$name" --version 2>&1 | head -n 1 || true));"
    done
    cat >&2 <<MESSAGE
minidual needs CPython 3.12, and none is on the PATH. Found:${seen:- no Python at all}
  remedy: install one of
    Debian, Ubuntu   apt-get install python3.12 python3.12-venv   (where the release has it)
    pyenv            pyenv install 3.12
    uv               uv python install 3.12
  or name it: make setup PYTHON=/path/to/python3.12
MESSAGE
    return 1
}

if ! is_312 "$venv/bin/python"; then
    python=$(find_python)
    echo "setup: $venv with $("$python" --version)"
    if ! "$python" -m venv --clear "$venv"; then
        echo "cannot create a virtual environment with $python" >&2
        echo "  remedy: on Debian and Ubuntu, apt-get install python3.12-venv" >&2
        exit 1
    fi
fi

# uv is 10 times faster than pip on these 7 GB. It comes from the same lock, by the same hashes.
uv=$venv/bin/uv
awk '/^[^ #]/ {inside = /^uv==/} inside' "$lock" >"$venv/uv.txt"
if ! "$uv" --version 2>/dev/null | grep -qF "$(sed -n 's/^uv==\([^ ]*\).*/\1/p' "$venv/uv.txt")"; then
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
        -r "$venv/uv.txt" || echo "setup: no uv, going on with pip (slower)" >&2
fi

# Compiled at once: where PYTHONDONTWRITEBYTECODE is set, as in many containers, each process would do it again.
echo "setup: installing and compiling the locked dependencies (about 7 GB on disk)"
if "$uv" --version >/dev/null 2>&1; then
    "$uv" pip sync --quiet --compile-bytecode --python "$venv/bin/python" --require-hashes "$lock"
    "$uv" pip install --quiet --python "$venv/bin/python" --no-deps --no-build-isolation --editable .
else
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r "$lock"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation \
        --editable .
fi
"$venv/bin/python" -m compileall -qq src scripts || true
echo "setup: compiling the numeric kernels (about half a minute)"
"$venv/bin/python" scripts/compile_kernels.py || echo "setup: not compiled; the first plan does it" >&2
touch "$venv/.ready"
echo "setup: done"
