"""What a user is told of a chain that was fitted to data."""

import re
from dataclasses import replace

import numpy as np
import pytest
from recordings import Recording, turn

from fvs_detector_node.config import PARAMETERS
from fvs_estimator_node.training import TrainingOptions, train
from fvs_ros.params import ParameterSet

FEW = TrainingOptions("poe", neurons=20)


def notes_of(recording, change=lambda data: data):
    return train(change(recording.data()), FEW).notes


def test_a_late_camera_and_many_outliers_are_told():
    late, outliers = notes_of(Recording(seconds=20.0, late_s=0.08))
    assert "the images show the joints of 80 ms before their stamps" in late
    assert "images do not fit" in outliers
    early, *_ = notes_of(Recording(seconds=20.0, late_s=-0.05, outliers=0.0))
    assert "50 ms after their stamps" in early
    for note, wanted_s in ((late, 0.08), (early, -0.05)):
        told = float(re.search(r"add (\S+) to stamp_delay_s", note)[1])
        assert ParameterSet(PARAMETERS)["stamp_delay_s"].check(told) == pytest.approx(
            wanted_s, abs=2e-3
        )
    assert "NTP" in early


def test_a_camera_that_was_moved_meanwhile_is_named_first():
    def bumped(data):
        ball = data.z.copy()
        half = len(ball) // 2
        ball[half:] = ball[half:] @ turn([0.0, 0.0, 1.0], np.radians(3.0)).T
        return replace(data, z=ball)

    note = notes_of(Recording(seconds=20.0, late_s=0.0, outliers=0.0), bumped)[0]
    assert "does not move on a rigid chain" in note
    assert 0 < note.index("moved the camera") < note.index("joint names")


def test_a_cameras_own_systematic_errors_are_no_alarm():
    def uneven(data):
        return replace(data, z=data.z + 0.0005 * np.sin(20.0 * data.z[:, [1, 2, 0]]))

    recording = Recording(seconds=30.0, noise_m=0.0003, late_s=0.0, outliers=0.0)
    assert notes_of(recording, uneven) == ()
