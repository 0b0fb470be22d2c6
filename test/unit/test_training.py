import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.line_fit import line_regressors
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.reference import reference_jacobian
from fvs_estimator_node.training import TrainingError, TrainingOptions, train

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ur5_dh import (
    BOX_M_RAD,
    HOME_RAD,
    ball_and_jacobian,
    jacobian_error,
    uniform_in_box,
)

NOISE_M = 1e-3
RIDGE = TrainingOptions(method="ridge")
SHORT = TrainingOptions(iterations=40)


def measured(rng, joints):
    return ball_and_jacobian(joints)[0] + NOISE_M * rng.standard_normal((len(joints), 3))


def probes(count, seed=0, size_rad=0.2):
    """Pairs of images, size_rad apart at most, anywhere in box M."""
    rng = np.random.default_rng(seed)
    middle = uniform_in_box(rng, count)
    half = 0.5 * rng.uniform(-size_rad, size_rad, (count, 6))
    joints = np.stack([middle - half, middle + half], axis=1).reshape(-1, 6)
    stamps = np.arange(2 * count) / 30.0
    return DataSet(stamps, joints, measured(rng, joints), np.repeat(np.arange(count), 2))


def smooth(duration_s, seed=0):
    """What the collector would record at 30 Hz."""
    rng = np.random.default_rng(seed)
    motion = RandomMotion(HOME_RAD, MotionConfig(duration_s, tuple(BOX_M_RAD)), rng)
    stamps = np.arange(0.0, duration_s, 1.0 / 30.0)
    joints, now = [], HOME_RAD.copy()
    for t in stamps:
        joints.append(now)
        now = now + motion.command(t, now) / 30.0
    joints = np.array(joints)
    return DataSet(stamps, joints, measured(rng, joints), np.zeros(len(stamps), dtype=int))


@pytest.fixture(scope="module")
def data():
    return probes(5000)


@pytest.fixture(scope="module")
def ridge(data):
    return train(data, RIDGE)


def test_a_line_is_what_many_small_midpoint_steps_add_up_to():
    rng = np.random.default_rng(1)
    centres, widths = rng.normal(size=(6, 5, 6)), rng.uniform(1.5, 2.0, (6, 5))
    start, end = rng.uniform(-0.5, 0.5, (2, 4, 6))
    places = np.linspace(0.0, 1.0, 401)
    points = [start + p * (end - start) for p in places]
    small = sum(line_regressors(centres, widths, a, b, 1) for a, b in pairwise(points))
    np.testing.assert_allclose(line_regressors(centres, widths, start, end, 3), small, atol=1e-4)


def test_ridge_meets_the_requirement(ridge):
    # 2.5 % is required of the trained networks; the ridge alone is about there
    assert jacobian_error(ridge.trained.model.jacobian) < 0.029


@pytest.mark.torch
def test_two_minutes_of_the_collectors_motion_suffice():
    result = train(smooth(120.0), SHORT)
    assert jacobian_error(result.trained.model.jacobian) < 0.02


def test_the_reported_errors_are_true_ones(ridge):
    joints = uniform_in_box(np.random.default_rng(9), 2000)
    true = ball_and_jacobian(joints)[1]
    off = ridge.trained.model.jacobian(joints) - true
    for i, network in enumerate(ridge.networks):
        column = np.sqrt(np.mean(np.sum(true[:, :, i] ** 2, axis=1)))
        error = np.sqrt(np.mean(np.sum(off[:, :, i] ** 2, axis=1)))
        assert network.column_m_rad == pytest.approx(column, rel=0.03, abs=5e-3)
        assert 0.7 * error < network.error_m_rad < 1.3 * error + 3e-3
    # pairs of far images: the noise of two positions and little else
    assert np.sqrt(6.0) * NOISE_M < ridge.trained.errors["pair_error_m"] < 8.0 * NOISE_M
    assert ridge.trained.errors["pair_error_relative"] < 0.02


def test_the_held_out_images_have_no_say(monkeypatch):
    # their ball positions are nonsense; the reported error says so, the choice does not notice
    monkeypatch.setattr("fvs_estimator_node.training._OUTLIER_FACTOR", 1e9)
    data, options = probes(600), RIDGE
    plain = train(data, options)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(data) // 2)  # the split's own draw: first thing after the seed
    place = np.empty(len(order))
    place[order] = (np.arange(len(order)) + 0.5) / len(order)
    held_out = np.repeat(place < 0.1, 2)
    assert held_out.sum() == plain.trained.errors["held_out_samples"]
    ball = data.ball_m.copy()
    ball[held_out] += 0.3 * rng.standard_normal((held_out.sum(), 3))
    spoilt = train(replace(data, ball_m=ball), options)
    assert spoilt.trained.errors["validation_error"] == plain.trained.errors["validation_error"]
    assert spoilt.trained.errors["pair_error_m"] > 20.0 * plain.trained.errors["pair_error_m"]


@pytest.mark.torch
def test_equal_seeds_give_equal_networks():
    data = probes(400)
    options = replace(SHORT, iterations=4, neurons=10)
    one, two = train(data, options).trained, train(data, options).trained
    other = train(data, replace(options, seed=1)).trained
    for name in ("centres", "widths", "weights"):
        np.testing.assert_array_equal(getattr(one.model, name), getattr(two.model, name))
    assert np.abs(one.model.weights - other.model.weights).max() > 0.0


def test_outliers_are_left_out(monkeypatch):
    data = smooth(90.0)
    ball, rng = data.ball_m.copy(), np.random.default_rng(5)
    bad = rng.random(len(data)) < 0.02
    ball[bad] += 0.1 * rng.standard_normal((bad.sum(), 3))
    spoilt = train(replace(data, ball_m=ball), RIDGE)
    monkeypatch.setattr("fvs_estimator_node.training._OUTLIER_FACTOR", 1e9)
    kept = train(replace(data, ball_m=ball), RIDGE)
    assert 0.7 * bad.sum() <= spoilt.trained.errors["outliers"] <= bad.sum() + 5
    assert any("left out" in note for note in spoilt.notes)
    assert spoilt.trained.errors["pair_error_m"] < 0.7 * kept.trained.errors["pair_error_m"]


@pytest.mark.torch
def test_progress_is_told_and_can_end_the_training():
    told = []
    data = probes(400)

    def progress(iteration, _iterations, error):
        told.append((iteration, error))
        return iteration == 3

    result = train(data, replace(SHORT, neurons=10), progress)
    assert [iteration for iteration, _ in told] == [1, 2, 3]
    assert result.trained.errors["iterations"] == 3
    assert told[-1][1] > 0.0


def test_data_that_cannot_teach_is_refused():
    data = probes(400)
    n = len(data)
    with pytest.raises(TrainingError, match="expected at least"):
        train(probes(20), RIDGE)
    with pytest.raises(TrainingError, match="joints hardly move"):
        train(replace(data, joints_rad=np.zeros((n, 6))), RIDGE)
    with pytest.raises(TrainingError, match="ball does not move"):
        train(replace(data, ball_m=np.ones((n, 3))), RIDGE)
    with pytest.raises(TrainingError, match="unknown training method"):
        TrainingOptions(method="magic")


def test_a_joint_that_stood_still_is_named():
    data = probes(400)
    joints = data.joints_rad.copy()
    joints[:, 4] = HOME_RAD[4]
    still = replace(data, joints_rad=joints, ball_m=ball_and_jacobian(joints)[0])
    result = train(still, RIDGE)
    assert any("wrist_2_joint did not move" in note for note in result.notes)
    assert np.all(np.isfinite(result.trained.model.jacobian(HOME_RAD)))


def test_the_reference_is_the_slope_of_the_positions():
    rng = np.random.default_rng(0)
    joints, at = uniform_in_box(rng, 800), uniform_in_box(rng, 50)
    found = reference_jacobian(joints, ball_and_jacobian(joints)[0], at, 1e-5, 4.0)
    true = ball_and_jacobian(at)[1]
    assert np.linalg.norm(found - true) < 0.01 * np.linalg.norm(true)


@pytest.mark.parametrize("late_s", [0.04, -0.02])
def test_a_time_offset_of_the_images_is_found_and_corrected(late_s):
    data, rng = smooth(90.0), np.random.default_rng(0)
    t = data.stamps_s
    seen = np.stack([np.interp(t - late_s, t, joint) for joint in data.joints_rad.T], axis=1)
    punctual, late = train(data, RIDGE), train(replace(data, ball_m=measured(rng, seen)), RIDGE)
    assert punctual.trained.errors["time_offset_s"] == pytest.approx(0.0, abs=1e-3)
    assert late.trained.errors["time_offset_s"] == pytest.approx(late_s, abs=1e-3)
    assert any("ms" in note for note in late.notes)
    assert not any("ms" in note for note in punctual.notes)
    wrong = jacobian_error(late.trained.model.jacobian)
    assert wrong < 1.3 * jacobian_error(punctual.trained.model.jacobian)


def test_without_torch_the_way_out_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "fvs_estimator_node.varpro", raising=False)
    with pytest.raises(TrainingError, match="needs torch: pip install torch, or use the method ri"):
        train(smooth(20.0), TrainingOptions(method="varpro"))
