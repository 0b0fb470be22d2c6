"""Every experiment: its quick run is complete, its runs are repeatable, its numbers are right."""

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("joblib")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from scipy.stats import levy_stable

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.online import LkfEstimator, OnlineConfig
from fvs_estimator_node.registry import create_estimator
from fvs_lab import contestants as who
from fvs_lab import experiment, main
from fvs_lab.correntropy import CorrentropyConfig, CorrentropyEstimator
from fvs_lab.estimators import Recording, jacobians_of, score
from fvs_lab.experiment import Context
from fvs_lab.report import EXPERIMENTS
from fvs_lab.robustness import EVERYDAY, HARSH, judged, schemes_called, trials_in
from fvs_lab.trials import (
    Bump,
    crossed,
    make_cases,
    run_trial,
    stable_noise_m,
)
from fvs_tools.workers import Workers


@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name not in ("everyday", "tags")])
def test_a_quick_run_makes_a_complete_page(name, tmp_path, monkeypatch):
    if name != "servo":  # rendering figures takes longer than the runs
        monkeypatch.setattr(experiment, "save", lambda figure, path: path.touch())
    command = [name, "--quick", "--jobs", "1", "--out", str(tmp_path)]
    assert main.main(command) == 0
    report = json.loads((tmp_path / name / "results.json").read_text(encoding="utf-8"))
    assert report["runs"]
    assert len({figure["file"] for figure in report["figures"]}) == len(report["figures"])
    for figure in report["figures"]:
        size = (tmp_path / name / figure["file"]).stat().st_size
        assert size > 10_000 or name != "servo"
    for table in report["tables"]:
        assert len({tuple(row) for row in table["rows"]}) == 1
    claims = [verdict["claim"] for verdict in report["verdicts"]]
    assert len(set(claims)) == len(claims)
    assert claims or report["tables"]
    page = (tmp_path / "index.md").read_text(encoding="utf-8")
    for text in (*claims, *(f"]({name}/{figure['file']})" for figure in report["figures"])):
        assert text in page


def test_a_smoke_test_of_a_scheme_settles(tmp_path):
    command = ["everyday", "--quick", "--scheme", "best", "--jobs", "1", "--out", str(tmp_path)]
    assert main.main(command) == 0
    report = json.loads((tmp_path / "everyday" / "results.json").read_text(encoding="utf-8"))
    assert [run["settled"] for run in report["runs"]] == [True]


# ---- runs -----------------------------------------------------------------------------------


def test_the_same_runs_come_from_one_process_and_from_two(tmp_path):
    worlds = [HARSH.draw(number) for number in (1, 2)]
    worlds[1] = replace(worlds[1], bump=Bump(0.2, (0.0, 0.5, 0.0), (0.0, 0.03, 0.0)))
    trials = [
        replace(trial, record=True, duration_s=0.5)
        for world in worlds
        for trial in trials_in(world, schemes_called(["proposed", "best"]))
    ]
    elsewhere = Context(tmp_path, workers=Workers(jobs=2)).map(run_trial, trials, "test")
    for here, there in zip(map(run_trial, trials), elsewhere, strict=True):
        np.testing.assert_equal(here, there)


def test_a_heavy_tails_worst_image_does_not_throw_an_arm_at_rest_off_its_target():
    (trial,) = trials_in(HARSH.draw(37), schemes_called(["best"]))
    run = run_trial(trial)
    assert run["settled"]
    assert not judged(run, HARSH.duration_s)


# ---- random worlds --------------------------------------------------------------------------


def test_worlds_are_functions_of_their_number_and_keep_their_ranges():
    worlds = [HARSH.draw(number) for number in range(1, 5)]
    assert HARSH.draw(3) == worlds[2]
    assert replace(HARSH, seed=7).draw(3).conditions != worlds[2].conditions
    for world in worlds:
        for name, (low, high) in HARSH.ranges.items():
            value = getattr(world.conditions, name, None)
            value = np.linalg.norm(value) if name == "camera_carried_deg" else value
            assert value is None or low <= value <= high or value == 2.0, name
    usual = EVERYDAY.draw(1)
    assert (usual.bump, usual.conditions.noise_exponent) == (None, 2.0)


def test_noise_is_alpha_stable():
    rng = np.random.default_rng(1)
    errors_m = np.concatenate([stable_noise_m(0.001, 1.6, rng) for _ in range(1_000)])
    true = levy_stable(1.6, 0.0, scale=0.001 / np.sqrt(2.0))
    for bound_m in (-0.003, 0.0, 0.001):
        assert np.mean(errors_m < bound_m) == pytest.approx(true.cdf(bound_m), abs=0.03)
    assert np.abs(errors_m).max() <= 0.1


def test_a_page_names_a_command_that_makes_it(tmp_path, capsys):
    arguments = ["everyday", "--seeds", "1", "--scheme", "rbf+pid"]
    assert main.main([*arguments, "--jobs", "1", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "index.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"Made by `fvs_experiments (.*?)`", page)
    assert shlex.split(command) == arguments
    assert main.main([*arguments[:-1], "none"]) == 2
    assert "known are proposed" in capsys.readouterr().err


# ---- estimators -----------------------------------------------------------------------------


def test_an_estimator_is_judged_before_it_learns_and_errors_add_up():
    """Without noise the filter explains the last of three steps of joint 1 exactly."""
    balls_m = np.array([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.02, 0.0]])
    times, moved = 0.1 * np.arange(1.0, 4.0), 0.1 * np.eye(6)[0]
    steps = tuple(
        MotionStep(float(t), 0.1, np.zeros(6), moved, ball)
        for t, ball in zip(times, balls_m, strict=True)
    )
    values = {"initial": "zero", "measurement_noise_m": 1e-6, "process_noise": 10.0}
    exact = create_estimator("lkf", {f"online.{name}": v for name, v in values.items()})
    recording = Recording(steps, times, balls_m, np.ones((3, 3, 6)))
    row = score(recording, jacobians_of(exact, recording), 0.5)
    assert row["t1_m"] == pytest.approx((0.01 + np.hypot(0.01, 0.02)) / 3.0)
    # the errors (10, 0), (-10, 20) and (0, 0) mm, summed up
    assert row["t2_max_m"] == pytest.approx(0.02)


def test_a_correntropy_filter_is_the_kalman_filter_but_for_what_is_far_off():
    rng, true = np.random.default_rng(2), np.array([[1.0, -0.5], [0.3, 0.8], [0.0, 0.4]])
    moves = 0.1 * rng.normal(size=(60, 2))
    exact = [MotionStep(0.1 * k, 0.1, np.zeros(2), m, true @ m) for k, m in enumerate(moves)]
    spoilt = [
        replace(s, d_feature_m=s.d_feature_m + 0.3 * (k % 9 == 8)) for k, s in enumerate(exact)
    ]

    def learned(estimator, steps):
        for step in steps:
            estimator.update(step)
        return estimator.jacobian(np.zeros(2))

    usual, wide = OnlineConfig(initial="zero"), CorrentropyConfig(initial="zero", bandwidth=1e6)
    kalman = learned(LkfEstimator(None, usual), spoilt)
    assert learned(CorrentropyEstimator(None, wide), spoilt) == pytest.approx(kalman)
    robust = learned(CorrentropyEstimator(None, replace(wide, bandwidth=4.0)), spoilt)
    assert 10.0 * np.linalg.norm(robust - true) < np.linalg.norm(kalman - true)


# ---- beyond the paper -----------------------------------------------------------------------


def test_best_is_close_to_the_floor_and_the_same_when_repeated():
    (case,) = make_cases("t", 1, 5)
    (trial,) = crossed([who.variant("best").changed(duration_s=2.0)], [case])
    outcome, again = run_trial(trial), run_trial(trial)
    assert outcome == again
    least_s = who.floor_s(case)
    assert least_s < outcome["to_5mm_s"] < 1.2 * least_s
