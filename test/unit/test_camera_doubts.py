"""What is said of images that do not fit the arm: bumps that come again and again, wrong stamps."""

import numpy as np
import pytest
from recordings import Recording, turn

from fvs_estimator_node.camera_doubts import CameraDoubts
from fvs_estimator_node.poe import PoeEstimator

ONES = np.ones(3)


def doubts_after(bumps_at, images):
    doubts = CameraDoubts()
    for number in range(images):
        doubts.image(ONES, ONES, number / 30.0, (np.eye(3),))
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
    assert doubts_after(at, 300).problem == ""  # the arm may move on: it is learned anew each time


def test_as_many_bumps_in_minutes_are_nothing_to_speak_of():
    assert doubts_after(range(0, 8000, 1000), 8000).remark == ""


def test_what_was_none_is_taken_back():
    doubts = doubts_after(range(100, 260, 20), 300)
    doubts.take_back(6)
    assert (doubts.bumps, doubts.remark) == (6, "")
    doubts.bump()
    assert (doubts.bumps, doubts.remark) == (7, "")


def test_after_many_bumps_the_last_one_is_taken_back_and_the_others_count():
    doubts = doubts_after(range(100, 112), 120)
    doubts.take_back(11)
    assert "carried" in doubts.remark


def test_wrong_stamps_that_looked_like_bumps_are_called_wrong_stamps():
    recording = Recording(seed=0, seconds=20.0, outliers=0.0, late_s=0.15)
    data, estimator = recording.data(), PoeEstimator(recording.chain())
    held = set()
    for row in zip(data.joints_rad, data.ball_m, data.stamps_s, strict=True):
        estimator.observe(*row)
        held.add(estimator.problem)
    held.discard("")
    assert held
    assert all("too late" in words for words in held)


@pytest.mark.parametrize(("late", "withheld"), [(2, False), (6, True)])
def test_an_arm_that_is_withheld_for_its_stamps_is_told_of_them_whatever_else_is_wrong(
    late, withheld
):
    doubts = CameraDoubts()
    share = np.clip((np.arange(60.0) - 20.0) / 15.0, 0.0, 1.0)
    way_m = (share * share * (3.0 - 2.0 * share))[:, None] * [0.4, 0.0, 0.0]
    for number in range(late, 60):
        doubts.image(way_m[number], way_m[number - late], number / 30.0, (np.eye(3),))
    assert "too late" in doubts.remark
    for _ in range(8):
        doubts.bump()
    assert ("too late" in doubts.problem) == withheld
    assert doubts.remark == doubts.problem if withheld else "carried" in doubts.remark


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
        estimator.observe(joints, change_ball(stamp_s, ball), stamp_s)
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
