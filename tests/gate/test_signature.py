"""`run --sign` and `status --verify`.

A changed verdict is named even if its digest was computed anew.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.gate.canonical import digest
from minidual.gate.signature import sign
from tests.support.pipeline_toys import Bench


def make_key(path: Path, passphrase: str = "") -> Path:
    command = [
        "ssh-keygen",
        "-q",
        "-t",
        "ed25519",
        "-N",
        passphrase,
        "-C",
        "someone",
        "-f",
        str(path),
    ]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return path


class Signed:
    """A run of toys behind the real command line, with a key."""

    def __init__(self, root: Path, capsys) -> None:
        self.bench = Bench(root / "runs")
        self._capsys = capsys
        self.folder = self.bench.store.folder
        self.key = root / "key"
        self.public = root / "key.pub"

    def __call__(self, *words: str | Path) -> tuple[int, str, str]:
        given = [*map(str, words), "--run", "toys", "--runs-dir", str(self.bench.root)]
        code = run_command_line(given, self.bench.table)
        out, err = self._capsys.readouterr()
        return code, out, " ".join(err.split())

    def verify(self, key: Path | None = None) -> tuple[int, str]:
        code, _, err = self("status", "--verify", key or self.public)
        return code, err


@pytest.fixture
def unsigned(tmp_path, capsys):
    make_key(tmp_path / "key")
    return Signed(tmp_path, capsys)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A signed run and its keys, to copy."""
    root = tmp_path_factory.mktemp("made")
    bench = Bench(root / "runs")
    bench.run_all()
    sign(bench.gate(), tuple(bench.table), make_key(root / "key"))
    return root


@pytest.fixture
def signed(tmp_path, capsys, made):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return Signed(tmp_path, capsys)


def forge(path: Path) -> None:
    """Raise what was observed, and compute everything that follows from it anew."""
    record = json.loads(path.read_bytes())
    record["data"] = {"observed": 99.0}
    record["digest"] = digest({key: record[key] for key in record if key != "digest"})
    path.write_text(json.dumps(record))


def test_an_untouched_run_verifies(signed):
    assert signed.verify() == (0, "signature: the verdicts and artefacts are as signed")
    code, out, _ = signed("status", "--json", "--verify", signed.public)
    assert (code, json.loads(out)["signature"]) == (0, {"key": str(signed.public), "changed": []})
    assert json.loads(signed("status", "--json")[1])["signature"] is None


def test_a_forged_last_stage_passes_the_gate_and_fails_the_signature(signed):
    forge(signed.bench.store.verdict_path("third"))
    assert signed.bench.states() == ["pass"] * 3, (
        "the digest has no key: this is what the signature is for"
    )
    assert signed.verify() == (1, "signature: third: its verdict was changed after it was signed")
    code, out, _ = signed("status", "--json", "--verify", signed.public)
    assert (code, len(json.loads(out)["signature"]["changed"])) == (1, 1)


def test_another_key_fails(signed, tmp_path):
    make_key(tmp_path / "other")
    code, said = signed.verify(tmp_path / "other.pub")
    assert code == 1
    assert "signed.json was signed by another key" in said


def test_a_list_of_verdicts_computed_anew_fails(signed):
    forge(signed.bench.store.verdict_path("third"))
    sha256 = signed.bench.gate().state("third").verdict_sha256
    listed = signed.folder / "signed.json"
    listed.write_text(json.dumps({**json.loads(listed.read_text()), "third": sha256}))
    code, said = signed.verify()
    assert code == 1
    assert "signed.json was changed after it was signed" in said


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("second/verdict.json", None, "second: its verdict is gone or corrupt"),
        ("second/verdict.json", "{", "second: its verdict is gone or corrupt"),
        ("second/out/numbers.txt", "9", "second: artefact out/numbers.txt changed"),
        ("signed.json", None, "signed.json does not exist"),
        ("signed.json.sig", None, "signed.json.sig does not exist"),
        ("signed.json.sig", "x", "signed.json was changed after it was signed"),
    ],
)
def test_damage_is_named(signed, name, content, said):
    (signed.folder / name).unlink()
    if content is not None:
        (signed.folder / name).write_text(content)
    code, err = signed.verify()
    assert code == 1
    assert said in err


def test_a_stage_that_ran_since_is_named_and_signed_with_the_next_run(signed):
    signed.bench.third.observed = 2.0  # else its verdict may be the same to the byte
    assert signed("third", "--force")[0] == 0
    code, said = signed.verify()
    assert (code, said) == (1, "signature: third: its verdict was changed after it was signed")
    assert signed("run", "--sign", signed.key)[0] == 0
    assert signed.verify()[0] == 0


def test_a_part_of_a_run(unsigned):
    code, _, err = unsigned("run", "--until", "second", "--sign", unsigned.key)
    assert code == 0
    assert f"signed: {unsigned.folder / 'signed.json.sig'}" in err
    assert unsigned.verify()[0] == 0
    assert unsigned("third")[0] == 0
    assert unsigned.verify() == (1, "signature: third: its verdict was not signed")


def test_a_run_that_fails_is_not_signed(unsigned):
    unsigned.bench.second.observed = 0.0
    code, _, err = unsigned("run", "--sign", unsigned.key)
    assert code == 1
    assert "not signed: a stage does not pass" in err
    assert not (unsigned.folder / "signed.json").exists()
    code, err = unsigned.verify()
    assert code == 1
    assert "signed.json does not exist" in err


def test_keys_that_cannot_be_used_are_named_before_work_starts(unsigned, tmp_path, monkeypatch):
    (tmp_path / "text").write_text("no key")
    (tmp_path / "text").chmod(0o600)
    locked = make_key(tmp_path / "locked", "secret")
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    for key, said in (
        (tmp_path / "none", "does not exist"),
        (tmp_path, "is a folder"),
        (tmp_path / "text", "cannot"),
    ):
        code, _, err = unsigned("run", "--sign", key)
        assert (code, unsigned.bench.first.contexts) == (2, [])
        assert str(key) in err
        assert said in err
    code, _, err = unsigned("run", "--sign", locked)
    assert (code, unsigned.bench.first.contexts) == (2, [])
    assert "passphrase" in err
    unsigned.bench.store.folder.mkdir(parents=True)
    for key, said in (
        (unsigned.key, "is no public key of OpenSSH"),
        (tmp_path / "none", "does not exist"),
    ):
        code, err = unsigned.verify(key)
        assert code == 2
        assert said in err


def test_without_openssh_the_program_is_named(unsigned, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    code, _, err = unsigned("run", "--sign", unsigned.key)
    assert (code, unsigned.bench.first.contexts) == (4, [])
    assert "openssh-client" in err
