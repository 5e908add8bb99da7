"""A verdict is derived, sealed, and refused when it was touched."""

from __future__ import annotations

import dataclasses
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.errors import DataError
from minidual.gate.canonical import digest, dumps
from minidual.gate.check import Check
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.verdict import Verdict, Waiver, derive_status, read_verdict

FINGERPRINT = Fingerprint(
    parameters={"a": {"b": 1}, "limits": [1.0, 2.0]},
    options={},
    inputs={"plan/x": "00"},
    upstream={"plan": "11", "gone": None},
    seed=7,
    profile="smoke",
    version="0",
    commit=None,
    machine={"cores": 2},
    libraries={"numpy": "2"},
)


def make_verdict(*checks: Check, **changes) -> Verdict:
    verdict = Verdict(
        stage="carry",
        run="toys",
        fingerprint=FINGERPRINT,
        checks=checks,
        artefacts={},
        acceptance_profile=True,
        started_at="t0",
        finished_at="t1",
        duration_s=1.5,
    )
    return dataclasses.replace(verdict, **changes)


checks_strategy = st.lists(
    st.builds(
        lambda observed, op, limit: (observed, op, limit if op else None),
        st.floats(width=32) | st.booleans() | st.integers(-9, 9),
        st.sampled_from(["<", "<=", ">", ">=", "==", None]),
        st.floats(allow_nan=False, allow_infinity=False, width=32),
    ),
    max_size=6,
).map(lambda rows: tuple(Check(f"c{i}", *row) for i, row in enumerate(rows)))


@settings(max_examples=60)
@given(checks_strategy)
def test_pass_if_and_only_if_all_limited_checks_pass_and_there_is_one(checks):
    limited = [check for check in checks if check.op is not None]
    status = derive_status(checks)
    assert (status == "pass") is (bool(limited) and all(check.passed for check in limited))
    assert (status == "error") is (not limited)


@settings(max_examples=60)
@given(checks_strategy)
def test_file_round_trip_keeps_everything(tmp_path_factory, checks):
    path = tmp_path_factory.mktemp("v") / "verdict.json"
    verdict = make_verdict(
        *checks,
        data={"curve": [1.0, float("nan")]},
        notes=("n",),
        options={"trials": 3},
    )
    path.write_text(dumps(verdict.to_json()))
    again, sha256 = read_verdict(path)
    assert again.to_json() == verdict.to_json()
    assert [type(check.observed) for check in again.checks] == [
        type(check.observed) for check in checks
    ]
    assert again.fingerprint == verdict.fingerprint
    assert len(sha256) == 64


def test_status_cannot_be_assigned():
    with pytest.raises(AttributeError):
        make_verdict(Check("x", 2, "<", 1)).status = "pass"  # type: ignore[misc]


def test_the_same_check_twice_is_refused():
    with pytest.raises(ValueError, match="'x' twice"):
        make_verdict(Check("x", 1, "<", 2), Check("x", 1, "<", 3))


def test_acceptance_needs_an_acceptance_profile_and_no_waiver():
    check = Check("x", 1, "<", 2)
    waiver = Waiver("carry", "in a hurry", {"plan": "fail"}, "t")
    assert make_verdict(check).to_json()["acceptance"] is True
    assert make_verdict(check, acceptance_profile=False).to_json()["acceptance"] is False
    assert make_verdict(check, waivers=(waiver,)).to_json()["acceptance"] is False


def _edit(record: dict, **changes) -> str:
    """Return an edited verdict with a matching digest: only its content can give it away."""
    record = {**record, **changes}
    record.pop("digest")
    return dumps({**record, "digest": digest(record)})


def _doubled() -> str:
    """Return a verdict that says "fail" and then "pass": the digest holds for the second."""
    return dumps(make_verdict(Check("x", 1, "<", 2)).to_json()).replace(
        "{",
        '{"status": "fail",',
        1,
    )


def _reasons():
    record = make_verdict(Check("x", 2, "<", 1), acceptance_profile=False).to_json()
    loose = [{**record["checks"][0], "passed": True}]
    yield "truncated", dumps(make_verdict(Check("x", 1, "<", 2)).to_json())[:-40], "is corrupt"
    yield "empty", "", "is corrupt"
    yield "a list", "[]", "not a JSON object"
    yield "a NaN", '{"duration_s": NaN}', "schema None is not 2"
    yield "a key twice", '{"stage": 1, "stage": 2}', "the key 'stage' stands 2 times"
    yield "a key twice, last one true", _doubled(), "the key 'status' stands 2 times"
    yield "edited", json.dumps({**record, "duration_s": 9.0}), "edited after it was written"
    yield "status", _edit(record, status="pass"), "it says status 'pass', its content says 'fail'"
    yield "acceptance", _edit(record, acceptance=True), "it says acceptance True"
    yield (
        "result",
        _edit(record, checks=loose),
        "it says checks.x.passed True, its content says False",
    )
    yield "schema", _edit(record, schema=99), "schema 99 is not 2"
    yield "missing part", _edit(record, fingerprint={}), "malformed verdict"


@pytest.mark.parametrize(("text", "message"), [pytest.param(t, m, id=n) for n, t, m in _reasons()])
def test_corrupt_verdicts_are_refused_by_name(tmp_path, text, message):
    path = tmp_path / "verdict.json"
    path.write_text(text)
    with pytest.raises(DataError, match="corrupt") as caught:
        read_verdict(path)
    assert str(path) in caught.value.message
    assert message in caught.value.message


def test_binary_rubbish_is_corrupt(tmp_path):
    path = tmp_path / "verdict.json"
    path.write_bytes(b"\xff\xfe\x00rubbish")
    with pytest.raises(DataError, match="corrupt"):
        read_verdict(path)


def test_differences_name_what_changed():
    now = dataclasses.replace(
        FINGERPRINT,
        parameters={"a": {"b": 2}, "limits": [1.0, 2.0], "new": True},
        options={"mood": "good"},
        inputs={"plan/x": "22", "plan/y": "33"},
        upstream={"plan": "44", "gone": None},
        seed=8,
        profile="standard",
    )
    assert FINGERPRINT.differences(now) == [
        "parameter a.b was 1, is 2",
        "parameter new was (absent), is True",
        "option mood was (absent), is good",
        "the seed was 7, is 8",
        "the profile was 'smoke', is 'standard'",
        "input plan/x changed or is gone",
        "input plan/y is new",
        "upstream stage plan ran again since",
    ]
    assert FINGERPRINT.differences(FINGERPRINT) == []


def test_version_commit_machine_and_libraries_only_warn():
    now = dataclasses.replace(
        FINGERPRINT,
        version="1",
        commit="abc",
        machine={"cores": 4},
        libraries={"numpy": "3"},
    )
    assert FINGERPRINT.differences(now) == []
    assert len(FINGERPRINT.circumstances(now)) == 4


def test_a_bool_is_not_the_number_one():
    now = dataclasses.replace(FINGERPRINT, parameters={"a": {"b": True}, "limits": [1.0, 2.0]})
    assert FINGERPRINT.differences(now) == ["parameter a.b was 1, is True"]
