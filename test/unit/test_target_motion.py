"""A target that moves: where it is now, how fast, and when it is another one."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.target_motion import TargetMotion, Update, on_own_clock

START = np.array([0.1, -0.1, 1.2])
VELOCITY = np.array([0.2, 0.0, -0.1])


def line(time_s):
    return START + VELOCITY * time_s


def circle(time_s, radius_m=0.1, speed_m_s=0.3):
    angle = speed_m_s / radius_m * time_s
    return START + radius_m * np.array([np.cos(angle), np.sin(angle), 0.0])


def told(path, until_s, rate_hz=30.0):
    motion = TargetMotion()
    times_s = np.arange(0.0, until_s, 1.0 / rate_hz)
    for time_s in times_s:
        motion.update(path(time_s), float(time_s))
    return motion, float(times_s[-1])


@pytest.mark.parametrize("age_s", [0.0, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 100.0])
def test_updates_that_are_told_late_are_those_of_a_moving_target_all_the_same(age_s, rate_hz):
    motion, told_s = TargetMotion(), 0.0
    for now_s in np.arange(0.0, 1.0, 0.008):
        if now_s >= told_s:
            told_s += 1.0 / rate_hz
            motion.update(line(now_s - age_s), now_s - age_s, age_s)
        if now_s > 0.3:
            target = motion.at(now_s)
            np.testing.assert_allclose(target.position_m, line(now_s), atol=1e-6)
            np.testing.assert_allclose(target.velocity_m_s, VELOCITY, atol=1e-5)
    # Silence counts from when it was told last, not from where the target was then.
    assert not motion.at(now_s + 3.5 / rate_hz + 1.0 / rate_hz).velocity_m_s.any()


@pytest.mark.parametrize(
    ("position", "after_s"),
    [
        (START + [0.3, 0.0, 0.0], 1 / 30),
        (START + [0.07, 0.0, 0.0], 1 / 30),
        (START, 0.5),
        (START, -1.0),
    ],
    ids=["a jump", "a small jump", "a pause", "back in time"],
)
def test_what_no_motion_goes_on_to_is_a_new_target(position, after_s):
    motion, last_s = told(lambda t: START, 0.5)
    assert motion.update(position, last_s + after_s) is Update.NEW
    target = motion.at(last_s + after_s + 0.01)
    np.testing.assert_array_equal(target.position_m, position)
    assert not target.velocity_m_s.any()


def test_a_stamp_of_another_clock_counts_from_now():
    assert on_own_clock(1.7e9, 0.3) == 0.3
    assert on_own_clock(0.2, 0.3) == 0.2


NOISES_M = (3e-4, 1e-3, 3e-3)


def noisy(path, noise_m, seed):
    rng = np.random.default_rng(seed)
    return lambda time_s: path(time_s) + noise_m * rng.normal(size=3)


def seen(path, noise_m, seed, from_s=1.0, until_s=5.0, rate_hz=30.0):
    """What a motion told with noise is taken for: times, s; positions, m; velocities, m/s."""
    motion, tell = TargetMotion(), noisy(path, noise_m, seed)
    times_s = np.arange(0.0, until_s, 1.0 / rate_hz)
    targets = []
    for time_s in times_s:
        motion.update(tell(time_s), float(time_s))
        targets.append(motion.at(float(time_s)))
    late = times_s >= from_s
    positions = np.array([one.position_m for one in targets])
    velocities = np.array([one.velocity_m_s for one in targets])
    return times_s[late], positions[late], velocities[late]


def rms(vectors):
    return np.sqrt(np.mean(np.sum(vectors**2, axis=1)))


@pytest.mark.parametrize("noise_m", NOISES_M)
def test_a_noisy_target_that_stands_does_stand(noise_m):
    for seed in range(3):
        _, positions, velocities = seen(lambda t: START, noise_m, seed)
        assert velocities.any(axis=1).mean() < 0.1
        assert rms(velocities) < noise_m / 1.0  # 1 s
        # It is where its updates are on average; the newest of them is off by root three times.
        assert rms(positions - START) < 0.5 * noise_m


@pytest.mark.parametrize(("speed_m_s", "noise_m"), [(0.1, 1e-3), (0.1, 3e-3), (0.3, 3e-3)])
def test_a_noisy_circle_is_known_about_as_well_as_it_is_told(speed_m_s, noise_m):
    def path(time_s):
        return circle(time_s, 0.08, speed_m_s)

    times_s, positions, velocities = seen(path, noise_m, 2)
    assert rms(positions - [path(one) for one in times_s]) < 1.1 * np.sqrt(3.0) * noise_m
    true = np.array([(path(one + 1e-4) - path(one - 1e-4)) / 2e-4 for one in times_s])
    assert rms(velocities - true) < 0.45 * speed_m_s


@pytest.mark.parametrize("noise_m", [0.0, 1e-3])
def test_a_target_that_stops_is_soon_known_to_stand(noise_m):
    motion, _ = told(noisy(lambda t: line(min(t, 2.0)), noise_m, 3), 2.4)
    target = motion.at(2.4)
    np.testing.assert_allclose(target.position_m, line(2.0), atol=3e-3)
    assert np.linalg.norm(target.velocity_m_s) < 0.1 * np.linalg.norm(VELOCITY)
