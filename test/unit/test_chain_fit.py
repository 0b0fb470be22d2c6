"""A chain is found in a minute of motion, says how well it is known, and whether it is one."""

from dataclasses import replace

import numpy as np
import pytest
import ur5_dh
from cases import each
from recordings import Recording, relative_error, ur5_chain
from scipy.spatial.transform import Rotation

from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import behind_play
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.pose import Pose


def error_of(fit, recording):
    """Median relative error of the Jacobian in the recording's box."""
    probes = recording.sampled_joints()
    true = recording.chain().jacobian(probes)
    return float(np.median(relative_error(fit.chain.jacobian(probes), true)))


@each(("joints", "prismatic"), [(7, []), (6, [0, 3])])
def test_a_chain_of_any_joints_is_found(joints, prismatic):
    rng = np.random.default_rng(joints)
    axes, steps = rng.normal(size=(joints, 3)), 0.15 * rng.normal(size=(joints, 3))
    points = np.array([0.0, 0.0, 1.3]) + np.cumsum(steps, axis=0) - steps.sum(axis=0)
    slides = np.isin(np.arange(joints), prismatic)
    chain = SerialChain(axes, points, points[-1] + 0.1, rng.uniform(-1.0, 1.0, joints), slides)
    stamps_s = np.arange(0.0, 60.0, 1.0 / 30.0)
    phases = np.outer(stamps_s, rng.uniform(0.5, 1.5, joints)) + rng.uniform(0.0, 6.0, joints)
    path = chain.reference_rad + 0.4 * np.sin(phases)
    seen = chain.position(path) + 0.001 * rng.normal(size=(len(path), 3))
    names = tuple(f"joint_{i}" for i in range(joints))
    fit = fit_chain(DataSet(stamps_s, path, seen, np.zeros(len(path), int), names))
    error = np.median(relative_error(fit.chain.jacobian(path), chain.jacobian(path)))
    assert error < 0.004
    np.testing.assert_array_equal(fit.chain.prismatic, slides)
    assert 0.5 < error / np.median(fit.jacobian_deviation(path)) < 2.0
    assert fit.is_chain


def test_a_minute_of_motion_is_enough():
    recording = Recording()
    fit = fit_chain(recording.data())
    assert error_of(fit, recording) < 0.002
    assert abs(fit.time_offset_s - recording.late_s) < 0.001
    assert fit.time_offset_deviation_s < 0.0005
    assert fit.misfit < 1.1
    assert 0.0008 < fit.ray_noise_m < 0.0012
    assert 0.0008 < fit.lateral_noise_m < 0.0012
    assert fit.outliers == pytest.approx(0.02 * fit.samples, rel=0.5)


def test_play_between_motors_and_joints_is_found():
    recording, plays_rad = Recording(late_s=0.0), np.array([0.0, 0.0175, 0.03, 0.0, 0.01, 0.0])
    data, position = recording.data(), recording.chain().position
    joints_rad = behind_play(data, plays_rad).joints_rad
    fit = fit_chain(replace(data, z=data.z + position(joints_rad) - position(data.joints_rad)))
    np.testing.assert_allclose(fit.chain.play_rad, plays_rad, atol=0.001)
    assert error_of(fit, recording) < 0.01
    assert fit.misfit < 1.2


@each(
    ("scales", "encoder_noise_rad"),
    [((1.0, 1.0, 1.0), 0.001), ((1.005, 1.005, 1.005), 0.0), ((0.98, 0.98, 1.0), 0.001)],
)
def test_it_says_how_good_it_is_with_a_camera_and_joints_that_err(scales, encoder_noise_rad):
    """In the frame of the camera as it is: what servoing by it needs."""
    recording = Recording()
    data = recording.data()
    noise_rad = encoder_noise_rad * np.random.default_rng(0).normal(size=data.joints_rad.shape)
    fit = fit_chain(replace(data, z=data.z * scales, joints_rad=data.joints_rad + noise_rad))
    probes = recording.sampled_joints(50)
    seen = np.diag(scales) @ recording.chain().jacobian(probes)
    error = np.median(relative_error(fit.chain.jacobian(probes), seen))
    assert 0.5 * error < np.median(fit.jacobian_deviation(probes)) < 2.0 * error
    assert fit.lens[0] == pytest.approx(scales[0] / scales[2] - 1.0, abs=2e-3)
    np.testing.assert_array_equal(fit.chain.lens, fit.lens * (scales[0] != scales[2]))
    assert fit.is_chain


def test_a_wrong_optimum_that_fits_nearly_as_well_is_left():
    """Depth noise hides the bend of the last axis, 3 cm from the ball: misfit 1.1 reversed."""
    rng = np.random.default_rng(5)
    rate, phase = rng.uniform(0.3, 1.3, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))

    def joints(time_s):
        return ur5_dh.HOME_RAD + 0.2 * np.sin(rate * time_s[:, None, None] + phase).sum(axis=2)

    front = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    arm = ur5_chain(rotation=front, origin_m=np.array([1.6, 0.0, 0.4]))
    aside = arm.feature_m - 0.04 * arm.axes[5] - 0.03 * arm.axes[4]
    chain = SerialChain(arm.axes, arm.points_m, aside, arm.reference_rad)
    stamps = np.arange(1800) / 30.0
    ball = chain.position(joints(stamps - 0.075))
    sight = ball / np.linalg.norm(ball, axis=1, keepdims=True)
    ball += 0.0007 * rng.normal(size=(1800, 3)) + 0.003 * rng.normal(size=(1800, 1)) * sight
    bad = rng.random(1800) < 0.02
    ball[bad] += 0.03 * rng.normal(size=(int(bad.sum()), 3))
    fit = fit_chain(DataSet(stamps, joints(stamps), ball, np.zeros(1800, dtype=int)))
    probes = ur5_dh.HOME_RAD + rng.uniform(-0.5, 0.5, (60, 6))
    error = relative_error(fit.chain.jacobian(probes), chain.jacobian(probes))
    assert np.median(error) < 0.002
    assert fit.misfit < 1.05


def test_a_joint_that_stood_still_spoils_no_other():
    still = 3
    reach = list(ur5_dh.BOX_M_RAD)
    reach[still] = 0.0
    recording = Recording(reach_rad=tuple(reach))
    fit = fit_chain(recording.data())
    probes = recording.sampled_joints()
    others = np.delete(np.arange(6), still)
    error = fit.chain.jacobian(probes) - recording.chain().jacobian(probes)
    assert np.linalg.norm(error[:, :, others], axis=(1, 2)).max() < 0.01
    assert np.median(fit.jacobian_deviation(probes[:20])) > 0.3


def test_joints_that_are_misnamed_show():
    data = Recording(seconds=20.0, late_s=0.0, outliers=0.2).data()
    swapped = data.joints_rad[:, [1, 0, 2, 3, 4, 5]]
    assert fit_chain(replace(data, joints_rad=swapped)).misfit > 2.0


@each("frozen", [False, True])
def test_a_stretch_that_is_far_off_pulls_at_nothing(frozen):
    recording = Recording()
    data = recording.data()
    ball = data.z.copy()
    ball[500:680] = ball[500] if frozen else ball[500:680] + [0.05, 0.0, 0.0]
    fit = fit_chain(replace(data, z=ball))
    assert error_of(fit, recording) < 0.001
    assert fit.outliers > 150


@each(
    ("spoilt", "words"),
    [
        (lambda data: replace(data, segment=np.arange(len(data)) // 10), "the data set has 0"),
        (lambda data: replace(data, z=1e-4 * data.z), "the ball does not move"),
        (lambda data: replace(data, z=1e3 * data.z), "has a place above 100 m"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_words(spoilt, words):
    with pytest.raises(ValueError, match=words):
        fit_chain(spoilt(Recording(seconds=15.0).data()))


# --- a tag in place of the ball ---


def pose_recording(recording, noise_m=3e-4, noise_rad=1e-3):
    """The chain with a tag on its last axis, where a ball would not move, and what is recorded."""
    pose, rng = Pose(0.3), np.random.default_rng([recording.seed, 9])
    chain = recording.chain()
    axis, point = chain.axes[5], chain.points_m[5]
    place_m = point + axis * (axis @ (chain.feature_m - point))
    chain = replace(
        chain, feature_m=pose.of_body(place_m, Rotation.random(random_state=rng).as_matrix())
    )
    stamps = np.arange(round(30.0 * recording.seconds)) / 30.0 + 1.0
    noise = rng.normal(size=(len(stamps), 6)) * ([noise_m] * 3 + [0.3 * noise_rad] * 3)
    exact = chain.position(recording.joints(stamps - recording.late_s))
    seen = np.array([pose.retract(*both) for both in zip(exact, noise, strict=True)])
    run = np.zeros(len(stamps), dtype=int)
    return chain, DataSet(stamps, recording.joints(stamps), seen, run, feature="pose")


def test_a_lens_bends_the_motion_of_a_tag_as_no_chain_does():
    data = pose_recording(Recording())[1]
    seen = data.kind.through_lens(data.z, 0.05 / 1.05, -0.05)  # at 1 / 1.05 of the distance
    fit = fit_chain(replace(data, z=np.array([data.kind.nearest(z) for z in seen])))
    np.testing.assert_allclose(fit.chain.lens, [0.05, -0.05], atol=0.004)
    assert fit.lens_covariance[0, 0] < 1e-3**2
    assert fit.is_chain


def test_a_tag_on_the_last_axis_is_fitted_to_less_than_a_thousandth():
    recording = Recording()
    chain, data = pose_recording(recording)
    fit, probes = fit_chain(data), recording.sampled_joints()
    true = chain.jacobian(probes)
    assert relative_error(fit.chain.jacobian(probes), true).max() < 1e-3
    assert fit.time_offset_s == pytest.approx(recording.late_s, abs=1e-3)
    assert fit.is_chain
    assert np.median(fit.jacobian_deviation(probes)) < 1e-3
