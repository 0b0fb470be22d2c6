"""What is said of images that do not fit the arm: bumps that come again and again."""

import numpy as np
import pytest
from recordings import Recording, turn

from fvs_estimator_node.camera_doubts import CameraDoubts
from fvs_estimator_node.poe import PoeEstimator


def doubts_after(bumps_at, images):
    doubts = CameraDoubts()
    for number in range(images):
        doubts.image()
        if number in bumps_at:
            doubts.bump()
    return doubts


def test_bumps_in_quick_succession_are_remarked_upon_until_they_are_long_ago():
    at = range(100, 260, 20)
    assert doubts_after(at, 239).remark == ""
    assert "carried" in doubts_after(at, 241).remark
    assert "carried" in doubts_after(at, 400).remark
    assert doubts_after(at, 401).remark == ""
    assert doubts_after(at, 401).bumps == 8


def test_as_many_bumps_in_minutes_are_nothing_to_speak_of():
    assert doubts_after(range(0, 8000, 1000), 8000).remark == ""


def unchanged(_stamp_s, ball):
    return ball


def told(change_joints=None, change_ball=unchanged, seed=0):
    """All remarks of an estimator that knows the chain, in 20 s of motion; and its bumps."""
    recording = Recording(seed=seed, seconds=20.0, outliers=0.0, late_s=0.0)
    data, estimator, remarks = recording.data(), PoeEstimator(recording.chain()), set()
    for stamp_s, seen_rad, ball in zip(data.stamps_s, data.joints_rad, data.ball_m, strict=True):
        joints = seen_rad.copy()
        if change_joints is not None:
            change_joints(joints)
        estimator.observe(joints, change_ball(stamp_s, ball))
        remarks.add(estimator.remark)
    return " ".join(sorted(remarks)), estimator.doubts.bumps


def flip(joint):
    def change(joints):
        joints[joint] *= -1.0

    return change


def swap(joints):
    joints[[1, 2]] = joints[[2, 1]]


def zero(joints):
    joints[2] += 0.3


@pytest.mark.parametrize(
    "change", [*map(flip, range(5)), swap, zero], ids=[*"12345", "swapped", "another zero"]
)
def test_joints_that_are_not_those_of_the_model_are_named(change):
    assert "another sign, zero, scale or name" in told(change)[0]


@pytest.mark.parametrize("seed", range(3))
def test_right_joints_and_single_bumps_are_no_cause_for_remarks(seed):
    turned = turn([0.3, 1.0, 0.2], np.radians(20.0))

    def bumped(stamp_s, ball):
        return turned @ ball + [0.05, 0.0, 0.0] if stamp_s > 10.0 else ball

    assert told(change_ball=bumped, seed=seed) == ("", 1)
    assert told(seed=seed) == ("", 0)
