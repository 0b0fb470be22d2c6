"""Networks and a chain are learned from a recording, or it is said why not."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from cases import each
from recordings import Recording, relative_error, rotation_about

from fvs_estimator_node.pairs import TrainingError
from fvs_estimator_node.training import TrainingOptions, train

RIDGE = TrainingOptions(method="ridge")
SMOOTH = Recording(seconds=90.0, late_s=0.0, outliers=0.0)


def error_of(result, recording):
    """Median relative error of the networks' Jacobian."""
    joints = recording.sampled_joints()
    true = recording.chain().jacobian(joints)
    return np.median(relative_error(result.model.jacobian(joints), true))


@pytest.mark.torch
def test_two_minutes_of_the_collectors_motion_suffice():
    recording, steps = replace(SMOOTH, seconds=120.0), []
    options = TrainingOptions(iterations=40)
    result = train(recording.data(), options, lambda *step: steps.append(step) or False)
    assert [step[:2] for step in steps] == [(i, 40) for i in range(1, 41)]
    assert error_of(result, recording) < 0.02


def test_outliers_are_left_out():
    data, rng = replace(SMOOTH, late_s=0.06).data(), np.random.default_rng(5)
    ball, bad = data.z.copy(), rng.random(len(data)) < 0.02
    ball[bad] += 0.1 * rng.standard_normal((bad.sum(), 3))
    spoilt = train(replace(data, z=ball), RIDGE)
    assert 0.7 * bad.sum() <= spoilt.errors["outliers"] <= bad.sum() + 5
    assert any("left out" in note for note in spoilt.notes)
    chain = train(replace(data, z=ball), TrainingOptions(method="poe"))
    far = ball[np.linalg.norm(ball - data.z, axis=1) > 0.05]
    assert not np.isin(chain.z_samples, far).any()  # targets are drawn from them


def test_data_that_cannot_teach_is_refused():
    data = Recording(seconds=15.0).data()
    with pytest.raises(TrainingError, match="joints hardly move"):
        train(replace(data, joints_rad=np.zeros_like(data.joints_rad)), RIDGE)
    with pytest.raises(TrainingError, match="does not move"):
        train(replace(data, z=np.ones_like(data.z)), RIDGE)
    with pytest.raises(TrainingError, match="unknown training method"):
        TrainingOptions(method="magic")


@each("late_s", [0.04, -0.02])
def test_a_time_offset_of_the_images_is_found_and_corrected(late_s):
    late = replace(SMOOTH, late_s=late_s)
    result = train(late.data(), RIDGE)
    assert result.errors["time_offset_s"] == pytest.approx(late_s, abs=1e-3)
    assert any("ms" in note for note in result.notes)
    assert error_of(result, late) < 0.04  # as of images without an offset: 0.032


def test_without_torch_the_way_out_is_named(monkeypatch):
    data = Recording(seconds=15.0).data()
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "fvs_estimator_node.varpro", raising=False)
    with pytest.raises(TrainingError, match="needs torch: pip install torch, or use the method ri"):
        train(data, TrainingOptions(method="varpro"))


def notes_of(seconds, change, **changes):
    data = Recording(seconds=seconds, late_s=0.0, outliers=0.0, **changes).data()
    return train(replace(data, z=change(data.z)), TrainingOptions("poe", neurons=20)).notes


def test_a_camera_that_was_moved_meanwhile_is_named_first():
    def bumped(ball):
        half, rotation = len(ball) // 2, rotation_about([0.0, 0.0, 1.0], np.radians(3.0))
        return np.vstack([ball[:half], ball[half:] @ rotation.T])

    note = notes_of(20.0, bumped)[0]
    assert "does not move on a rigid chain" in note
    assert 0 < note.index("moved the camera") < note.index("joint names")


def test_a_cameras_own_systematic_errors_are_no_alarm():
    def uneven(ball):
        return ball + 0.0005 * np.sin(20.0 * ball[:, [1, 2, 0]])

    assert notes_of(30.0, uneven, noise_m=0.0003) == ()
