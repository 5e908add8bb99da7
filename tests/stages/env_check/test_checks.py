"""The checks of `env-check`: sound measurements pass, a broken one fails its own check."""

from dataclasses import replace

from tests.support.env_check_samples import SOUND, failing, judged


def test_measurements_in_which_all_is_well_pass():
    checks = judged()
    reported = {name for name, check in checks.items() if check.op is None}
    assert reported == {"latency.wall_median_us"}
    assert all(check.passed for name, check in checks.items() if name not in reported)


def test_a_joint_that_never_arrives_fails_the_rise_time():
    responses = list(SOUND.responses)
    responses[6] = replace(responses[6], rise_s=float("nan"))
    checks = judged(responses=responses)
    assert failing(checks) == {"joints.rise_max_s"}
    assert "left_panda_joint7" in checks["joints.rise_max_s"].remedy
