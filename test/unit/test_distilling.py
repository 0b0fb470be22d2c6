"""What a user is told of a chain that was fitted to data."""

from dataclasses import replace

import numpy as np
from recordings import Recording, rotation_about

from fvs_estimator_node.training import TrainingOptions, train

FEW = TrainingOptions("poe", neurons=20)


def notes_of(recording, change=lambda data: data):
    return train(change(recording.data()), FEW).notes


def test_a_camera_that_was_moved_meanwhile_is_named_first():
    def bumped(data):
        ball = data.z.copy()
        half = len(ball) // 2
        ball[half:] = ball[half:] @ rotation_about([0.0, 0.0, 1.0], np.radians(3.0)).T
        return replace(data, z=ball)

    note = notes_of(Recording(seconds=20.0, late_s=0.0, outliers=0.0), bumped)[0]
    assert "does not move on a rigid chain" in note
    assert 0 < note.index("moved the camera") < note.index("joint names")


def test_a_cameras_own_systematic_errors_are_no_alarm():
    def uneven(data):
        return replace(data, z=data.z + 0.0005 * np.sin(20.0 * data.z[:, [1, 2, 0]]))

    recording = Recording(seconds=30.0, noise_m=0.0003, late_s=0.0, outliers=0.0)
    assert notes_of(recording, uneven) == ()
