"""The allowed-collision matrix: when it has converged, what that is worth, and that the rule can fail."""

import dataclasses
import itertools
import json
import os
from pathlib import Path

import pytest

from minidual.collision import acm
from minidual.collision.acm import QUIET_DOUBLINGS, acm_report, build_acm
from minidual.robot.description import links_of
from minidual.robot.models import PANDA
from minidual.robot.pair import DUAL_PANDA, SIDES, Robot


@pytest.fixture(scope="module")
def built():
    return acm_report(DUAL_PANDA)


def test_the_matrix_has_converged_by_its_own_rule(built):
    assert built.converged
    sizes = [r["samples_n"] for r in built.rounds]
    assert sizes[0] >= 20_000
    assert all(b == 2 * a for a, b in itertools.pairwise(sizes))
    assert all(not r["changed"] for r in built.rounds[-QUIET_DOUBLINGS:])
    assert built.samples_n == sizes[-1]


def test_too_few_samples_change_classes_and_do_not_converge():
    """Negative control of the rule: from 50 samples on, pairs still change, and a limit ends it unconverged."""
    short = build_acm(DUAL_PANDA, samples_min=50, samples_max=400)
    assert not short.converged
    assert any(r["changed"] for r in short.rounds)
    assert "NOT converged" in short.lines()[0]
    assert short.samples_n <= 400


def test_the_rarest_contact_is_far_from_being_missed(built):
    """A pair that touched n times in N samples is missed by N samples with probability exp(-n) or so."""
    assert built.rarest_n > 30
    first, second = built.rarest.split(" + ")
    assert not any({first, second} == {a, b} for a, b, _ in built.acm)  # it is checked


def test_cross_arm_pairs_never_enter(built):
    links = links_of(DUAL_PANDA)
    assert all(links[a].side == links[b].side for a, b, _ in sorted(built.acm))


def test_reasons_say_how_many_samples(built):
    never = [r for _, _, r in sorted(built.acm) if r.startswith("never")]
    assert set(never) == {f"never in {built.samples_n} samples"}


def test_history_survives_the_cache(built, tmp_path, monkeypatch):
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path))
    monkeypatch.setattr(acm, "build_acm", lambda _: built)
    fresh = acm_report.__wrapped__
    assert fresh(DUAL_PANDA) == built
    (file,) = tmp_path.glob("acm-*.json")
    assert json.loads(file.read_text().splitlines()[1])["rounds"] == built.rounds
    assert fresh(DUAL_PANDA) == built


def _rows_added(file: Path) -> None:
    """Pairs of one arm that touch, declared to be allowed."""
    digest, content = file.read_text().split("\n")
    record = json.loads(content)
    checked = [
        ["left_panda_hand", f"left_panda_link{k}", "never in 80000 samples"] for k in range(5)
    ]
    file.write_text(f"{digest}\n{json.dumps({**record, 'pairs': record['pairs'] + checked})}")


def _rows_edited(file: Path) -> None:
    file.write_text(file.read_text().replace("never in", "always in", 1))


def _of_another_robot(file: Path) -> None:
    content = file.read_text().split("\n")[1].replace("panda_link", "panda_lonk")
    digest = acm._digest("another model", content)
    file.write_text(f"{digest}\n{content}")


def _without_fields(file: Path) -> None:
    (name,) = {file.name}
    model = acm.model_hash(DUAL_PANDA)
    assert name == f"acm-{model[:20]}.json"
    file.write_text(f"{acm._digest(model, '[]')}\n[]")


def _replaced_by(make):
    def damage(file: Path) -> None:
        file.unlink()
        make(file)

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        _rows_added,
        _rows_edited,
        _of_another_robot,
        _without_fields,
        lambda file: file.write_text(""),
        lambda file: file.write_bytes(file.read_bytes()[:-1000]),
        lambda file: file.write_bytes(b"\xff" * 100),
        lambda file: os.truncate(file, 3 * 1024**3),
        _replaced_by(os.mkfifo),
        _replaced_by(lambda file: file.symlink_to("/dev/zero")),
        _replaced_by(lambda file: file.symlink_to(file)),
    ],
    ids=[
        "added",
        "edited",
        "other",
        "fields",
        "empty",
        "cut",
        "bytes",
        "3 GB",
        "pipe",
        "device",
        "loop",
    ],
)
def test_a_damaged_cache_is_built_again(built, tmp_path, monkeypatch, damage):
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path))
    builds: list[Robot] = []
    monkeypatch.setattr(acm, "build_acm", lambda robot: builds.append(robot) or built)
    fresh = acm_report.__wrapped__
    fresh(DUAL_PANDA)
    (file,) = tmp_path.glob("acm-*.json")
    good = file.read_bytes()
    damage(file)
    assert sorted(fresh(DUAL_PANDA).acm) == sorted(built.acm)
    assert len(builds) == 2, "the damaged file was believed"
    assert not file.is_symlink()
    assert file.read_bytes() == good
    fresh(DUAL_PANDA)
    assert len(builds) == 2, "the mended file was not"


def test_a_cache_that_cannot_be_written_costs_only_time(built, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path / "file"))
    monkeypatch.setattr(acm, "build_acm", lambda _: built)
    assert acm_report.__wrapped__(DUAL_PANDA) == built


def test_pairs_that_the_model_rules_out_count_in_either_order():
    """A reversed pair must not be sampled too: it would get a second reason."""
    pairs = (("panda_link5", "panda_hand"), ("panda_link2", "panda_link0"))
    tables = []
    for never_touch in (pairs, tuple((b, a) for a, b in pairs)):
        robot = Robot(dataclasses.replace(PANDA, never_touch=never_touch))
        tables.append(sorted(build_acm(robot, samples_min=50, samples_max=50).acm))
    assert tables[0] == tables[1]
    by_pair = {(a, b): reason for a, b, reason in tables[0]}
    assert len(by_pair) == len(tables[0])
    assert (
        by_pair["left_panda_hand", "left_panda_link5"]
        == by_pair["right_panda_link0", "right_panda_link2"]
        == "model"
    )


@pytest.mark.parametrize("ruling", ["left", "right"])
def test_two_different_arms_have_the_matrix_of_each(ruling):
    """What one model rules out is no reason for the other arm."""
    strict = dataclasses.replace(PANDA, never_touch=(("panda_link2", "panda_link0"),))
    robot = Robot(strict, PANDA) if ruling == "left" else Robot(PANDA, strict)
    matrix = build_acm(robot, samples_min=50, samples_max=50).acm
    reasons = {(a, b): reason for a, b, reason in matrix}
    by_model = {side for side in SIDES if reasons.get(_shoulder(side)) == "model"}
    assert by_model == {ruling}
    assert acm.model_hash(robot) != acm.model_hash(Robot(robot.arm))


def _shoulder(side: str) -> tuple[str, str]:
    return f"{side}_panda_link0", f"{side}_panda_link2"
