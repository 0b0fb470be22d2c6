"""Targets told with the noise of a camera: the arm goes along with their motion, not the noise."""

from __future__ import annotations

import numpy as np
import pytest
from control_plant import NOISE_M, chain_of_the_arm, servo
from ur5_dh import HOME_RAD, ball_and_jacobian

from fvs_tools.schemes import BEYOND

EXTENDED = BEYOND["extended"].controller_values
ARRIVE = {"law": "arrive"}
CENTRE_M = ball_and_jacobian(HOME_RAD)[0]
RADIUS_M = 0.08


def follow(values, speed_m_s, noise_m, feed_forward):
    """Rms distance from the true target, m, and of the command's step, rad/s, after 1.5 s."""
    rng = np.random.default_rng(7)
    true_m = []

    def target_of(time_s):
        angle = speed_m_s / RADIUS_M * time_s
        true_m.append(CENTRE_M + RADIUS_M * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0]))
        return true_m[-1] + noise_m * rng.normal(size=3)

    run = servo(
        HOME_RAD,
        HOME_RAD,
        seed=1,
        values={**values, "target_feed_forward": feed_forward},
        duration_s=4.0,
        target_of=target_of,
        chain=chain_of_the_arm() if values.get("law") == "arrive" else None,
        jacobian_error=0.01,
    )
    assert set(run.states) <= {"SERVOING", "SETTLED"}
    late = run.time_s > 1.5
    error_m = np.linalg.norm(run.ball_m - true_m, axis=1)[late]
    steps = np.diff(run.command[late], axis=0)
    return np.sqrt(np.mean(error_m**2)), np.sqrt(np.mean(steps**2))


@pytest.mark.parametrize("noise_m", [3e-4, 1e-3, 3e-3])
@pytest.mark.parametrize("values", [{}, EXTENDED, ARRIVE], ids=["usual", "extended", "arrive"])
def test_a_noisy_target_that_stands_moves_the_arm_no_more_than_without_feed_forward(
    values, noise_m
):
    (off_m, step), (alone_m, alone_step) = (
        follow(values, 0.0, noise_m, on) for on in (True, False)
    )
    assert off_m < 1.2 * alone_m
    assert step < 1.2 * alone_step
    assert off_m < 0.6 * noise_m + 0.5 * NOISE_M


@pytest.mark.parametrize("noise_m", [1e-3, 3e-3])
@pytest.mark.parametrize("values", [{}, EXTENDED, ARRIVE], ids=["usual", "extended", "arrive"])
def test_a_noisy_target_on_a_circle_is_followed_closer_than_without_feed_forward(values, noise_m):
    (off_m, step), (alone_m, alone_step) = (
        follow(values, 0.1, noise_m, on) for on in (True, False)
    )
    assert off_m < 0.8 * alone_m
    assert step < alone_step
