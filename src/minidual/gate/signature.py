"""Signature over the verdicts of a run, made and verified by OpenSSH (`ssh-keygen -Y`).

runs/<run>/signed.json      {stage: sha256 of its verdict.json}
runs/<run>/signed.json.sig  signature over the bytes of signed.json, written last
"""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import TypeAdapter

from minidual.durable import regular_file, write_text
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.gate import Gate
from minidual.gate.verdict import manifest_changes

SIGNED_FILE = "signed.json"
_KEY_BYTES_MAX = 100_000
_SIGNED_BYTES_MAX = 1_000_000
_PUBLIC = re.compile(r"[a-z][\w@.-]+ AAAA[A-Za-z0-9+/]+=*")
_IDENTITY = "minidual"


def _keygen(*words: str | Path, content: bytes) -> subprocess.CompletedProcess[bytes]:
    program = shutil.which("ssh-keygen")
    if program is None:
        raise EnvironmentMissingError(
            "signatures need the program ssh-keygen",
            remedy="install OpenSSH's client (Debian: openssh-client)",
        )
    # In a session of its own it has no terminal on which to ask for a passphrase and wait.
    return subprocess.run(
        [program, "-Y", *map(str, words), "-n", _IDENTITY],
        input=content,
        capture_output=True,
        check=False,
        start_new_session=True,
    )


def signature(key: Path, content: bytes) -> str:
    """Return the signature over `content`.

    Args:
        key: A private key, or a public one of which the agent has the private key.
        content: What is signed.

    Raises:
        UsageError, EnvironmentMissingError: The key cannot be used; there is no ssh-keygen.
    """
    done = _keygen("sign", "-f", regular_file(key, _KEY_BYTES_MAX), content=content)
    if done.returncode:
        reason = " ".join(done.stderr.decode(errors="replace").split())
        raise UsageError(
            f"cannot sign with {key}: {reason}",
            remedy="`ssh-keygen -t ed25519 -N '' -f FILE` makes a key; "
            "of one in ssh-agent, give the .pub file",
        )
    return done.stdout.decode()


def sign(gate: Gate, stages: Sequence[str], key: Path) -> Path:
    """Sign the verdicts of `stages`; return the path of the signature."""
    hashes = {name: gate.state(name).verdict_sha256 for name in stages}
    text = dumps({name: sha256 for name, sha256 in hashes.items() if sha256})
    signature_path = gate.store.folder / f"{SIGNED_FILE}.sig"
    signature_text = signature(key, text.encode())
    write_text(signature_path.with_name(SIGNED_FILE), text)
    write_text(signature_path, signature_text)
    return signature_path


def unverified(gate: Gate, key: Path) -> list[str]:
    """Return the differences from the signature by `key`, or why they cannot be told.

    Args:
        gate: Of the run.
        key: Public key.

    Raises:
        DataError: `key` is no public key of OpenSSH.
    """
    public = _public_key(key)
    path = gate.store.folder / SIGNED_FILE
    signature_path = path.with_name(f"{SIGNED_FILE}.sig")
    try:
        content = regular_file(path, _SIGNED_BYTES_MAX).read_bytes()
        regular_file(signature_path, _KEY_BYTES_MAX)
        fault = _signature_fault(public, signature_path, content)
        if fault:
            return [f"{path} was {fault}"]
        signed = TypeAdapter(dict[str, str]).validate_json(content)
    except (DataError, OSError, ValueError) as error:
        return [f"no signature: {error}"]
    return _differences(gate, signed)


def _public_key(key: Path) -> str:
    text = regular_file(key, _KEY_BYTES_MAX).read_text(encoding="utf-8", errors="replace")
    match = _PUBLIC.match(text)
    if match is None:
        raise DataError(
            f"{key} is no public key of OpenSSH",
            remedy="give the .pub file of the key that signed",
        )
    return match[0]


def _signature_fault(public: str, signature_path: Path, content: bytes) -> str:
    """Return why `content` is not as the owner of the key signed it; "" if it is."""
    with tempfile.NamedTemporaryFile("w", suffix=".allowed") as allowed:
        allowed.write(f"{_IDENTITY} {public}\n")
        allowed.flush()
        signers = ("-f", allowed.name, "-I", _IDENTITY)
        verified = _keygen("verify", *signers, "-s", signature_path, content=content)
        if verified.returncode == 0:
            return ""
        intact = _keygen("check-novalidate", "-s", signature_path, content=content)
        if intact.returncode == 0:
            return "signed by another key"
        return "changed after it was signed"


def _differences(gate: Gate, signed: Mapping[str, str]) -> list[str]:
    """Return a line per verdict or artefact that differs from the signed {stage: sha256}."""
    lines = [f"{name}: no such stage" for name in signed if name not in gate.table]
    for name in gate.table:
        state = gate.state(name)
        then = signed.get(name)
        now = state.verdict_sha256
        if then != now:
            if not then:
                change = "was not signed"
            elif not now:
                change = "is gone or corrupt"
            else:
                change = "was changed after it was signed"
            lines.append(f"{name}: its verdict {change}")
        elif state.folder is not None and state.verdict is not None:
            for reason in manifest_changes(state.folder, state.verdict.artefacts):
                lines.append(f"{name}: {reason}")
    return lines
