"""Configuration: profiles, overrides, and messages that name file, line and dotted path."""

from __future__ import annotations

import os

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.config.document import parse_document, parse_value
from minidual.config.loader import (
    SHIPPED_FOLDER,
    Override,
    load_config,
    parse_override,
    shipped_profiles,
)
from minidual.config.root import Config
from minidual.errors import ConfigError, UsageError
from minidual.stages.registry import STAGES


@pytest.fixture
def profile(tmp_path):
    def write(text: str, name: str = "mine.yaml") -> str:
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    return write


def refusal(path: str, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", ["smoke", "standard", "gpu"])
def test_shipped_profiles_load(name):
    loaded = load_config(name)
    assert loaded.profile == name
    assert loaded.config.acceptance is (name != "smoke")


def test_there_are_three_profiles_inside_the_package():
    assert shipped_profiles() == ("gpu", "smoke", "standard")
    assert SHIPPED_FOLDER.parent.name == "minidual"


def test_unknown_profile_names_those_there_are():
    with pytest.raises(
        UsageError,
        match="no profile 'smok'; there are gpu, smoke, standard",
    ) as caught:
        load_config("smok")
    assert caught.value.remedy == "did you mean 'smoke'?"


def test_extends_merges_deeply_and_keeps_the_rest(profile):
    base = profile(
        "extends: smoke\nscene:\n  object:\n    mass_kg: 0.3\n    friction: 0.6\n",
        "base.yaml",
    )
    top = profile("extends: base.yaml\nscene:\n  object:\n    friction: 0.7\n", "top.yaml")
    loaded = load_config(top)
    assert loaded.config.scene.object.mass_kg == 0.3
    assert loaded.config.scene.object.friction == 0.7
    assert loaded.config.plan == load_config("smoke").config.plan
    assert [path.name for path in loaded.sources] == [
        "standard.yaml",
        "smoke.yaml",
        "base.yaml",
        "top.yaml",
    ]
    assert loaded.profile == "top"
    assert base


def test_mapping_that_is_one_value_is_replaced_by_a_profile_and_edited_by_set(profile):
    default = Config().benchmark.success_rate_min
    assert len(default) > 1
    over = load_config(profile("benchmark:\n  success_rate_min: {act: 0.4}\n"))
    assert over.config.benchmark.success_rate_min == {"act": 0.4}
    top = load_config(
        profile("extends: mine.yaml\nbenchmark:\n  success_rate_min: {moveit: 0.3}\n", "top.yaml"),
    )
    assert top.config.benchmark.success_rate_min == {"moveit": 0.3}
    edited = load_config("standard", ["benchmark.success_rate_min.act=0.25"])
    assert edited.config.benchmark.success_rate_min == {**default, "act": 0.25}


def test_a_power_of_ten_is_a_number_as_in_yaml_1_2(profile):
    assert (
        load_config(
            profile("scene:\n  physics:\n    timestep_s: 1e-3\n"),
        ).config.scene.physics.timestep_s
        == 1e-3
    )


def test_circle_of_profiles_is_refused(profile):
    profile("extends: b.yaml\n", "a.yaml")
    assert "circle: a.yaml -> b.yaml -> a.yaml" in refusal(
        profile("extends: a.yaml\n", "b.yaml").replace("b.y", "a.y"),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 1\nplan:\n  querys_n: 3\n", "mine.yaml:3: plan.querys_n: no such key; plan has"),
        ("seed: 1\nplaning: {}\n", "mine.yaml:2: planing: no such key; the root has acceptance"),
        (
            "plan:\n  queries_n: 3\n  queries_n: 4\n",
            "mine.yaml:3: plan.queries_n: stands twice (first at mine.yaml:2)",
        ),
        (
            "plan:\n  queries_n: 0\n",
            "mine.yaml:2: plan.queries_n: must be greater than or equal to 1, is 0",
        ),
        ("plan:\n  queries_n: .nan\n", "mine.yaml:2: plan.queries_n: .nan is not a finite number"),
        ("plan:\n  queries_n: nan\n", "mine.yaml:2: plan.queries_n: nan is not a finite number"),
        (
            "scene:\n  object:\n    mass_kg: .inf\n",
            "mine.yaml:3: scene.object.mass_kg: .inf is not a finite number",
        ),
        (
            "scene:\n  object:\n    mass_kg: 1.0e+999\n",
            "mine.yaml:3: scene.object.mass_kg: 1.0e+999 is not a finite number",
        ),
        ("seed: '3'\n", "mine.yaml:1: seed: must be a valid integer, is the text '3'"),
        ("seed: true\n", "mine.yaml:1: seed: must be a valid integer, is true"),
        ("seed: on\n", "mine.yaml:1: seed: must be a valid integer, is the text 'on'"),
        ("seed: 010\n", "mine.yaml:1: seed: must be a valid integer, is the text '010'"),
        ("seed: 1:30\n", "mine.yaml:1: seed: must be a valid integer, is the text '1:30'"),
        ("acceptance: on\n", "mine.yaml:1: acceptance: must be a valid boolean, is the text 'on'"),
        ("seed: 1.5\n", "mine.yaml:1: seed: must be a valid integer, is 1.5"),
        ("seed:\n", "mine.yaml:1: seed: must be a valid integer, is null"),
        ("plan: 3\n", "mine.yaml:1: plan: must be a section, is 3"),
        ("", "mine.yaml is empty"),
        ("- a\n", "mine.yaml:1: it must be a mapping of sections, not a list"),
        ("seed: [1\n", "mine.yaml:2: not YAML"),
        ("seed: !!python/name:os.system x\n", "mine.yaml:1: seed: tags such as"),
        ("? [a]\n: 1\n", "mine.yaml:1: the file: a key must be a word"),
        ("plan: &a\n  b: *a\n", "mine.yaml:2: aliases are not read here"),
        (
            "seed: 1\nplan: " + "[" * 2000 + "]" * 2000,
            "mine.yaml:2: nested more than 32 levels deep",
        ),
        ("seed: 1\nplan: [" + "1," * 21_000 + "]", "mine.yaml:2: more than 20000 values"),
        ("report:\n  title: " + "x" * 300_000, "holds 300,017 bytes; at most 262,144 are read"),
        ('report:\n  title: "\\ud800"', "mine.yaml:2: half of a surrogate pair is no character"),
        ('"\\ud800": 1', "mine.yaml:1: half of a surrogate pair is no character"),
        ("seed: 1__0\n", "mine.yaml:1: seed: must be a valid integer, is the text '1__0'"),
        ("seed: 1_\n", "mine.yaml:1: seed: must be a valid integer, is the text '1_'"),
        ("seed: 1" + "0" * 5000, "mine.yaml:1: seed: 1000"),
        (
            "train:\n  steps: 1" + "0" * 300,
            "is out of range; a number is 0, or from 1e-15 to 9.22e+18",
        ),
        (
            "scene:\n  physics:\n    timestep_s: 1e-300\n",
            "mine.yaml:3: scene.physics.timestep_s: 1e-300 is out of",
        ),
        (
            "scene:\n  physics:\n    timestep_s: 1e-9\n",
            "must be greater than or equal to 0.00001, is 1e-09",
        ),
        (
            "carry:\n  sensing: {pose_rate_hz: 1e-6}\n",
            "mine.yaml:2: carry.sensing.pose_rate_hz: must be greater than or equal to 1",
        ),
        (
            "scene:\n  object:\n    xy_m: [1e9, 0]\n",
            "mine.yaml:3: scene.object.xy_m.0: must be less than or equal to 10",
        ),
        ("extends: nope\n", "mine.yaml:1: extends: no profile 'nope'"),
        ("extends: nope.yaml\n", "mine.yaml:1: extends: no profile file"),
        ("extends: [smoke, gpu]\n", "mine.yaml:1: extends: must be one profile's name or file"),
        (
            "scene:\n  object:\n    grasp_offset_m: 0.24\n",
            "mine.yaml:2: scene.object: grasp_offset_m 0.24 lies beyond",
        ),
    ],
)
def test_refusals_name_file_line_and_path(profile, text, message):
    assert message in refusal(profile(text))


def test_all_problems_come_in_one_message(profile):
    text = refusal(profile("seed: -1\nplan:\n  queries_n: 0\n"))
    assert "mine.yaml:1: seed:" in text
    assert "mine.yaml:3: plan.queries_n:" in text


def test_remedies_say_what_to_write(profile):
    assert "did you mean 'queries_n'?" in refusal(profile("plan:\n  querys_n: 3\n"))
    assert "write a number without quotes" in refusal(
        profile("scene:\n  physics:\n    timestep_s: '0.001'\n"),
    )
    assert "write true or false" in refusal(profile("acceptance: yes\n"))


def test_error_in_an_extended_file_names_that_file(profile):
    profile("plan:\n  queries_n: 0\n", "base.yaml")
    assert "base.yaml:2: plan.queries_n" in refusal(profile("extends: base.yaml\nseed: 3\n"))


def test_smoke_cannot_be_made_acceptance(profile):
    assert "cannot be made to" in refusal(profile("extends: smoke\nacceptance: true\n"))
    assert "cannot be made to" in refusal("smoke", "acceptance=true")
    assert load_config(profile("extends: smoke\n")).config.acceptance is False


def test_a_file_may_not_take_a_shipped_name(profile):
    assert "bears the name of the shipped profile 'standard'" in refusal(
        profile("seed: 1\n", "standard.yaml"),
    )


def test_missing_and_unreadable_files(tmp_path, profile):
    assert "no profile file" in refusal(str(tmp_path / "none.yaml"))
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe")
    assert "cannot read" in refusal(str(tmp_path / "bytes.yaml"))
    os.mkfifo(tmp_path / "pipe.yaml")
    assert "no profile file" in refusal(str(tmp_path / "pipe.yaml"))
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    assert "no profile file" in refusal(str(tmp_path / "zero.yaml"))
    with (tmp_path / "large.yaml").open("wb") as file:
        file.truncate(3 * 1024**3)
    assert "large.yaml holds 3,221,225,472 bytes; at most 262,144 are read" in refusal(
        str(tmp_path / "large.yaml"),
    )


def test_overrides_apply_in_order_and_are_remembered():
    loaded = load_config(
        "standard",
        ["plan.queries_n=3", "plan.queries_n=4", "scene.physics.timestep_s=1e-3"],
    )
    assert loaded.config.plan.queries_n == 4
    assert loaded.config.scene.physics.timestep_s == 1e-3
    assert [item.text for item in loaded.overrides][1] == "--set plan.queries_n=4"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("plan.queries_n", "not of the form section.key=value"),
        ("plan..x=1", "not of the form"),
        ("=1", "not of the form"),
        ("report.titl\udcff=1", "not of the form"),
        (
            "plan.queries_n=0",
            "--set plan.queries_n=0: plan.queries_n: must be greater than or equal to 1, is 0",
        ),
        ("plan.queries_n=many", "must be a valid integer, is the text 'many'"),
        ("plan.querys_n=3", "--set plan.querys_n=3: plan.querys_n: no such key"),
        ("scene.object.mass_kg=nan", "nan is not a finite number"),
        ("scene.object.mass_kg=1e999", "1e999 is not a finite number"),
        ("seed.deeper=1", "seed is a single value and has no keys"),
        ("plan=3", "--set plan=3: plan: must be a section, is 3"),
        ("plan.queries_n=[1", "not YAML"),
    ],
)
def test_bad_overrides_are_refused(override, message):
    assert message in refusal("standard", override)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("-3", -3),
        ("1e-3", 1e-3),
        ("1_000", 1000),
        (".5", 0.5),
        ("true", True),
        ("null", None),
        ("", ""),
        ("[a, b]", ["a", "b"]),
        ("abc", "abc"),
        ("'3'", "3"),
        ("on", "on"),
        ("a: b", {"a": "b"}),
    ],
)
def test_values_typed_on_the_command_line(text, value):
    assert parse_value(text, "--set", "a") == value
    assert type(parse_value(text, "--set", "a")) is type(value)


quantities = st.floats(1e-15, 9e18) | st.floats(-9e18, -1e-15) | st.just(0.0)


@settings(max_examples=60)
@given(quantities | st.integers(-(10**12), 10**12))
def test_numbers_survive_the_command_line(value):
    assert parse_override(f"a.b={value!r}").value == value


scalars = st.none() | st.booleans() | st.integers(-(2**63), 2**63) | quantities
words = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True).filter(
    lambda w: w not in ("true", "false", "null", "nan"),
)


@settings(max_examples=60)
@given(st.dictionaries(words, scalars | words | st.lists(scalars, max_size=3), max_size=5))
def test_what_yaml_dumps_is_read_back(tree):
    """Text such as "inf" is the exception: read as a number it would be no finite one."""
    tree = {key: value for key, value in tree.items() if value != "inf"}
    assert parse_document(yaml.safe_dump(tree), "x.yaml").tree == tree


def test_resolved_file_is_a_profile_that_gives_the_same_again(tmp_path):
    loaded = load_config("smoke", ["seed=5", "scene.physics.timestep_s=0.00001"])
    path = tmp_path / "resolved.yaml"
    path.write_text(loaded.to_yaml())
    assert load_config(str(path)).config == loaded.config


def test_loaded_configuration_is_frozen():
    loaded = load_config()
    with pytest.raises(Exception, match="frozen"):
        loaded.config.seed = 3  # type: ignore[misc]
    changed = loaded.with_overrides([Override("seed", 3, "--seed 3")])
    assert (changed.config.seed, load_config().config.seed) == (3, loaded.config.seed)


def test_every_option_of_every_stage_overrides_a_value_that_exists():
    for entry in STAGES.values():
        for path in entry.settings.values():
            value = Config()
            for part in path.split("."):
                value = getattr(value, part)
            assert isinstance(value, int | float | str | tuple | dict), path


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_option_that_is_no_finite_number_is_refused_by_name(value):
    """`--speed nan` passes the option parser, which takes any float."""
    with pytest.raises(
        ConfigError,
        match=f"--speed {value}: arbiter.speed_override: must be a finite number",
    ):
        load_config().with_overrides(
            [Override("arbiter.speed_override", value, f"--speed {value}")],
        )
