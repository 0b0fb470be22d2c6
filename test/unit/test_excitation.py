"""What a fit finds, and that the chosen courses say more than the random ones."""

from dataclasses import replace

import numpy as np
import pytest
import ur5_dh
from recordings import Recording, relative_error

from fvs_estimator_node.chain_chart import OFFSET
from fvs_estimator_node.chain_fit import MAX_OFFSET_S, fit_chain
from fvs_estimator_node.excitation import ChainExaminer, best_course, information
from fvs_estimator_node.knowledge import Findings, NothingYet, Question
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.pairing import BallSample


def samples_of(data):
    columns = (data.stamps_s, data.joints_rad, data.ball_m, data.segment.tolist())
    return tuple(BallSample(float(t), *rest) for t, *rest in zip(*columns, strict=True))


def motion_of(seed, **limits):
    config = MotionConfig(duration_s=200.0, **limits)
    return RandomMotion(ur5_dh.HOME_RAD, config, np.random.default_rng(seed))


def test_it_finds_how_well_the_chain_is_known_from_all_it_was_told():
    recording = Recording(seed=2, seconds=24.0)
    samples = samples_of(recording.data())
    examiner, motion = ChainExaminer(), motion_of(0)
    early = examiner.findings(Question(samples[:400], motion, 400 / 30.0))
    later = examiner.findings(Question(samples[400:], motion, 24.0))
    assert isinstance(later, Findings)
    assert later.is_chain
    assert later.image_offset_s == pytest.approx(0.08, abs=0.002)
    assert later.jacobian_deviation < early.jacobian_deviation
    places = recording.places()
    chain = fit_chain(recording.data()).chain
    error = np.median(relative_error(chain.jacobian(places), recording.chain().jacobian(places)))
    assert 0.4 < error / later.jacobian_deviation < 2.0


def test_a_ball_that_moves_otherwise_is_said_to_be_on_no_chain():
    data = Recording(seconds=20.0).data()
    swing = 0.02 * np.sin(0.9 * data.stamps_s)[:, None]
    moved = replace(data, ball_m=data.ball_m + swing)
    found = ChainExaminer().findings(Question(samples_of(moved), motion_of(0), 20.0))
    assert not found.is_chain
    assert found.misfit > 2.0
    # By noise alone it would be known well.
    fit, places = fit_chain(moved), Recording().places()
    by_noise = np.median(replace(fit, unfitted=0.0 * fit.unfitted).jacobian_deviation(places))
    true = Recording().chain().jacobian(places)
    error = np.median(relative_error(fit.chain.jacobian(places), true))
    assert 2.0 * by_noise < found.jacobian_deviation
    assert error / 3.0 < found.jacobian_deviation < 3.0 * error


@pytest.mark.parametrize("focal_error", [0.01, -0.01])
def test_a_camera_whose_focal_length_is_told_wrongly_never_is_enough(focal_error):
    data = Recording(seed=2).data()
    seen = replace(data, ball_m=data.ball_m * np.array([1.0, 1.0, 1.0 + focal_error]))
    found = ChainExaminer().findings(Question(samples_of(seen), motion_of(0), 60.0))
    assert found.is_chain
    assert found.jacobian_deviation > 0.002  # what config/collect_minute.yaml stops at


def test_images_too_far_apart_never_are_enough(monkeypatch):
    monkeypatch.setattr("fvs_estimator_node.chain_fit._STARTS", 3)  # none is known to be right
    samples = samples_of(Recording(seconds=80.0, outliers=0.0).data())[::8]
    found = ChainExaminer().findings(Question(samples, motion_of(0), 80.0))
    assert np.isnan(found.misfit)
    assert not found.is_chain
    assert 0.0 < found.jacobian_deviation < 0.01  # by the noise, whatever that is


def test_too_little_is_nothing_yet():
    samples = samples_of(Recording(seconds=4.0).data())
    found = ChainExaminer().findings(Question(samples, motion_of(0), 12.0))
    assert found == NothingYet()


def test_the_information_of_the_images_is_the_inverse_of_the_covariance_they_gave():
    recording = Recording(seed=1, seconds=30.0, outliers=0.0)
    data = recording.data()
    fit = fit_chain(data)
    used = (data.stamps_s >= data.stamps_s[0] + MAX_OFFSET_S) & (
        data.stamps_s <= data.stamps_s[-1] - MAX_OFFSET_S
    )
    time_s = data.stamps_s[used] - 0.08
    velocity = (recording.joints(time_s + 1e-4) - recording.joints(time_s - 1e-4)) / 2e-4
    gained = information(fit, recording.joints(time_s), velocity)
    # in the fit's own units; what the data hardly say is the prior's
    root = np.linalg.cholesky(fit.covariance)
    values = np.linalg.eigvalsh(root.T @ gained @ root)
    assert values.max() < 1.02
    assert np.median(values) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    "limits",
    [
        {},
        {
            "joint_range_rad": (0.2,) * 6,
            "max_joint_velocity_rad_s": 0.15,
            "max_joint_acceleration_rad_s2": 0.5,
        },
    ],
    ids=["usual", "narrow and slow"],
)
def test_chosen_courses_teach_faster_than_going_on_at_random(limits):
    """Deviations predicted after 12 s of the same motion and three stretches of 4 s."""
    gains = []
    noise = {"ray_noise_m": 0.003, "lateral_noise_m": 0.0005}
    some_fit = fit_chain(Recording(seconds=10.0).data())
    some_fit = replace(some_fit, unfitted=0.0 * some_fit.unfitted)
    for seed in range(3):
        fit = replace(some_fit, chain=Recording(seed=seed).chain(), **noise)
        deviations = []
        for chosen in (False, True):
            motion = motion_of(seed, **limits)
            low, high = motion.box_rad
            places = np.random.default_rng(seed).uniform(low, high, (30, 6))
            rng = np.random.default_rng(seed)
            known = np.diag(np.repeat([1.0, 100.0], [OFFSET, 1]))
            for begin, end in ((0.0, 12.0), (12.0, 16.0), (16.0, 20.0), (20.0, 24.0)):
                if chosen and begin > 0.0:
                    now = replace(fit, covariance=np.linalg.inv(known))
                    motion.change_over(best_course(now, motion, begin, 30.0, rng), begin)
                times = np.arange(begin, end, 1.0 / 30.0)
                known = known + information(fit, *motion.path(times))
            now = replace(fit, covariance=np.linalg.inv(known))
            deviations.append(float(np.median(now.jacobian_deviation(places))))
        gains.append(deviations[1] / deviations[0])
    assert np.median(gains) < 0.93
