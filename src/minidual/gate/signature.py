"""Signature over the verdicts of a run, made and verified by OpenSSH (`ssh-keygen -Y`).

runs/<run>/signed.json      {stage: sha256 of its verdict.json}
runs/<run>/signed.json.sig  signature over the bytes of signed.json, written last
"""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from pydantic import TypeAdapter

from minidual.durable import regular_file, write_text
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.gate import Gate
from minidual.gate.verdict import manifest_changes

SIGNED_FILE = "signed.json"
_KEY_BYTES = 100_000
_PUBLIC = re.compile(r"[a-z][\w@.-]+ AAAA[A-Za-z0-9+/]+=*")


def _keygen(*words: str | Path, content: bytes) -> subprocess.CompletedProcess[bytes]:
    if (program := shutil.which("ssh-keygen")) is None:
        remedy = "install OpenSSH's client (Debian: openssh-client)"
        raise EnvironmentMissingError("signatures need the program ssh-keygen", remedy=remedy)
    # In a session of its own it has no terminal on which it could ask for a passphrase and wait.
    command = [program, "-Y", *map(str, words), "-n", "minidual"]
    return subprocess.run(
        command,
        input=content,
        capture_output=True,
        check=False,
        start_new_session=True,
    )


def signature(key: Path, content: bytes) -> str:
    """Return the signature over `content` by a private key, or by the agent's key if `key` is a public one.

    Raises:
        UsageError, EnvironmentMissingError: The key cannot be used; there is no ssh-keygen.
    """
    done = _keygen("sign", "-f", regular_file(key, _KEY_BYTES), content=content)
    if done.returncode:
        said = " ".join(done.stderr.decode(errors="replace").split())
        remedy = "`ssh-keygen -t ed25519 -N '' -f FILE` makes a key; of one in ssh-agent, give the .pub file"
        raise UsageError(f"cannot sign with {key}: {said}", remedy=remedy)
    return done.stdout.decode()


def sign(gate: Gate, stages: Sequence[str], key: Path) -> Path:
    """Sign the verdicts of `stages`; return the path of the signature."""
    states = [gate.state(name) for name in stages]
    text = dumps({state.name: state.verdict_sha256 for state in states if state.verdict_sha256})
    sealed = gate.store.folder / f"{SIGNED_FILE}.sig"
    made = signature(key, text.encode())
    write_text(sealed.with_name(SIGNED_FILE), text)
    write_text(sealed, made)
    return sealed


def unverified(gate: Gate, key: Path) -> list[str]:
    """Return what differs from what the owner of the public key `key` has signed, or why that is not known.

    Raises:
        DataError: `key` is no public key of OpenSSH.
    """
    if (
        public := _PUBLIC.match(
            regular_file(key, _KEY_BYTES).read_text(encoding="utf-8", errors="replace"),
        )
    ) is None:
        raise DataError(
            f"{key} is no public key of OpenSSH",
            remedy="give the .pub file of the key that signed",
        )
    path = gate.store.folder / SIGNED_FILE
    sealed = path.with_name(f"{SIGNED_FILE}.sig")
    try:
        content = regular_file(path, 1_000_000).read_bytes()
        regular_file(sealed, _KEY_BYTES)
        with tempfile.NamedTemporaryFile("w", suffix=".allowed") as allowed:
            allowed.write(f"minidual {public[0]}\n")
            allowed.flush()
            if _keygen(
                "verify",
                "-f",
                allowed.name,
                "-I",
                "minidual",
                "-s",
                sealed,
                content=content,
            ).returncode:
                intact = not _keygen("check-novalidate", "-s", sealed, content=content).returncode
                return [
                    f"{path} was {'signed by another key' if intact else 'changed after it was signed'}",
                ]
        signed = TypeAdapter(dict[str, str]).validate_json(content)
    except (DataError, OSError, ValueError) as error:
        return [f"no signature: {error}"]
    found = [f"{name}: no such stage" for name in signed if name not in gate.table]
    for state in map(gate.state, gate.table):
        then = signed.get(state.name)
        now = state.verdict_sha256
        if then != now:
            differs = "was changed after it was signed" if now else "is gone or corrupt"
            found.append(f"{state.name}: its verdict {differs if then else 'was not signed'}")
        elif state.folder and state.verdict:
            found += [
                f"{state.name}: {reason}"
                for reason in manifest_changes(state.folder, state.verdict.artefacts)
            ]
    return found
