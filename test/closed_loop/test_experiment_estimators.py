"""The comparison of estimators along smooth motion: repeatable, a-priori, and adding up."""

import json

import numpy as np
import pytest

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_lab.context import Context
from fvs_lab.estimators import report_of
from fvs_lab.estimators_contestants import CONTESTANTS, GRIDS
from fvs_lab.estimators_recordings import (
    Recording,
    binned,
    criteria,
    judge,
    record,
)
from fvs_lab.estimators_study import NOISE, Job, judge_all, study
from fvs_lab.estimators_verdicts import disagreements
from fvs_lab.lockstep import load_networks, make_estimator
from fvs_lab.report import Origin, write_report
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, simulation_of

CLEAN = Conditions(rendered=False, position_noise_m=0.0, depth_noise=0.0)
DURATION_S = 2.0


def quick(tmp_path, jobs=1):
    return Context(out=tmp_path, seeds=1, jobs=jobs, quick=True, rendered=False)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return study(quick(tmp_path_factory.mktemp("study")))


@pytest.fixture(scope="module")
def clean():
    return record(3, CLEAN, DURATION_S)


# ---------------------------------------------------------------------------------- the study
def test_the_same_configuration_gives_the_same_numbers_in_any_process(tmp_path):
    context = quick(tmp_path, jobs=2)
    jobs = [
        Job(NOISE.conditions(context, seed), seed, 1.0, tuple(CONTESTANTS.values()))
        for seed in (1, 2)
    ]
    here = [judge_all(job) for job in jobs]
    for one, other in zip(here, context.map(judge_all, jobs, "test"), strict=True):
        assert other.summaries == one.summaries
        np.testing.assert_equal(other.curves, one.curves)


def test_a_recording_is_repeated_whatever_was_recorded_between(clean):
    record(4, CLEAN, 0.1)
    again = record(3, CLEAN, DURATION_S)
    np.testing.assert_array_equal(again.time_s, clean.time_s)
    np.testing.assert_array_equal(again.true_jacobian, clean.true_jacobian)


def test_everyone_is_judged_on_the_same_steps_in_every_world(found):
    names = {one.name for one in found.contestants}
    for results in found.judged.values():
        for one in results:
            assert one.summaries.keys() == names
            assert one.visible_share > 0.9


def test_a_linear_measurement_makes_the_unscented_filter_the_linear_one(found):
    for results in found.judged.values():
        assert all(one.ukf_difference_m_rad < 1e-9 for one in results)


def test_the_oracle_is_the_best_in_every_world(found):
    for world in found.worlds:
        for one in found.contestants:
            if one.method != "oracle":
                assert found.middle(world, "oracle", "t1_m") < 0.2 * found.middle(
                    world, one.name, "t1_m"
                )


def test_learning_pays_when_the_camera_was_rotated(found):
    (turned,) = found.turned
    assert found.middle(turned, "rbf", "t1_m") < 0.6 * found.middle(turned, "frozen", "t1_m")


def test_the_report_has_pictures_tables_and_plain_numbers(found, tmp_path):
    context = quick(tmp_path)
    report = report_of(context, found)
    folder = context.folder(report.name)
    for figure in report.figures:
        assert (folder / figure.file).stat().st_size > 10_000
    assert len(report.tables) == 3  # a table a world, and nothing was tuned
    assert len(report.verdicts) >= 5
    path = write_report(report, folder, Origin("", "", "", True))
    data = json.loads(path.read_text(encoding="utf-8"))["data"]
    assert data["seeds"] == [1]
    assert data["worlds"].keys() == {"clean", "noise", "turned_20"}
    results = data["worlds"]["noise"]["results"]
    assert np.isfinite([value for one in results.values() for value in one[0].values()]).all()


# ---------------------------------------------------------------------------------- recordings
def test_a_recording_stays_in_the_box_and_its_truth_is_what_was_seen(clean):
    joints = np.array([step.joints_rad for step in clean.steps])
    assert np.all(np.abs(joints - HOME_RAD) <= BOX_RAD)
    seen = np.array([step.d_ball_m for step in clean.steps])
    np.testing.assert_allclose(clean.true_d_ball_m, seen, atol=1e-12)
    assert clean.visible_share == 1.0
    assert clean.position_error_m < 1e-12


def test_the_prelude_moves_one_joint_after_the_other(clean):
    prelude = [step for step, t in zip(clean.steps, clean.time_s, strict=True) if t <= 0.0]
    moved = np.sum([np.abs(step.d_joints_rad) for step in prelude], axis=0)
    assert np.all(moved > 0.1)
    alone = [np.sort(np.abs(step.d_joints_rad))[-1] for step in prelude]
    together = [np.abs(step.d_joints_rad).sum() for step in prelude]
    assert np.sum(alone) > 0.9 * np.sum(together)


def test_the_oracle_errs_by_micrometres_without_noise(clean):
    oracle = make_estimator("oracle", simulation_of(CLEAN), load_networks())
    track = judge(oracle, clean, True)
    assert track.t1_m.max() < 1e-5
    assert track.jacobian_error.max() < 1e-12


# ---------------------------------------------------------------------------------- judgement
class KnowsTheLastStep(Estimator):
    """Explains each step exactly, once it has seen it."""

    def __init__(self):
        self.reset()

    def jacobian(self, joints_rad):
        return self.learned.copy()

    def update(self, step):
        moved = step.d_joints_rad
        self.learned = np.outer(step.d_ball_m, moved) / (moved @ moved)

    def reset(self):
        self.learned = np.zeros((3, 6))


def made_up(balls_m, first_s=0.1):
    """Each step moves joint 1 by 0.1 rad; one step each 0.1 s."""
    moved = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    times = first_s + 0.1 * np.arange(len(balls_m))
    steps = tuple(
        MotionStep(float(t), 0.1, np.zeros(6), moved, np.asarray(ball, dtype=float))
        for t, ball in zip(times, balls_m, strict=True)
    )
    true = np.ones((len(steps), 3, 6))
    return Recording(steps, times, np.array(balls_m, dtype=float), true, 1.0, 0.0)


def test_who_learns_perfectly_still_pays_for_each_step_first():
    balls_m = [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.02, 0.0]]
    track = judge(KnowsTheLastStep(), made_up(balls_m), True)
    np.testing.assert_allclose(track.t1_m, [0.01, np.hypot(0.01, 0.02), 0.0], atol=1e-15)
    # the errors (10, 0), (-10, 20) and (0, 0) mm, summed up
    np.testing.assert_allclose(track.t2_m, [0.01, 0.02, 0.02], atol=1e-15)


@pytest.mark.parametrize(("hears", "t1_m"), [(True, 0.0), (False, 0.01)])
def test_the_prelude_is_heard_or_not_and_never_scored(hears, t1_m):
    recording = made_up([[0.01, 0.0, 0.0]] * 2, first_s=0.0)
    track = judge(KnowsTheLastStep(), recording, hears)
    np.testing.assert_allclose(track.t1_m, [t1_m], atol=1e-15)


def test_t2_adds_up_what_t1_sees_one_by_one():
    wrong_m = np.array([[0.001, 0.0, 0.0], [0.001, 0.0, 0.0], [-0.002, 0.0, 0.0]])
    t1_m, t2_m = criteria(wrong_m)
    np.testing.assert_allclose(t1_m, [0.001, 0.001, 0.002])
    np.testing.assert_allclose(t2_m, [0.001, 0.002, 0.0], atol=1e-18)


def test_bins_are_means_and_empty_ones_are_no_number():
    edges_s = np.array([0.0, 1.0, 2.0, 3.0])
    times_s, values = np.array([0.5, 1.0, 2.5, 9.0]), np.array([1.0, 3.0, 5.0, 7.0])
    np.testing.assert_array_equal(binned(times_s, values, edges_s), [2.0, np.nan, 5.0])


# ---------------------------------------------------------------------------------- who and how
def test_tuned_values_go_where_they_belong():
    chosen = {"lkf_explored": 0.5, "lkf_model": 0.25, "rbf_tuned": 2.0}
    values = {name: one.tuned(chosen).values for name, one in CONTESTANTS.items()}
    assert values["lkf_explored"]["lkf.process_noise"] == 0.5
    assert values["ukf_explored"]["ukf.process_noise"] == 0.5
    assert values["lkf_zero"]["lkf.process_noise"] == 0.5
    assert values["ukf_model"]["ukf.process_noise"] == 0.25
    assert values["rbf_tuned"]["rbf.n1"] == 2.0
    assert "rbf.n1" not in values["rbf"]
    assert values["lkf_fast"] == CONTESTANTS["lkf_fast"].values


def test_all_methods_are_tuned_over_equally_many_values():
    assert {len(set(grid.values)) for grid in GRIDS.values()} == {8}


def test_criteria_disagree_where_they_order_two_differently():
    assert disagreements({"a": 1.0, "b": 2.0, "c": 3.0}, {"a": 1.0, "b": 3.0, "c": 2.0}) == (1, 3)
