import numpy as np
import pytest

from fvs_estimator_node.motion import RandomMotion

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
HALF = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])
VELOCITY, ACCELERATION = 0.65, 2.0


def motion(seed=0, half=HALF, **limits):
    return RandomMotion(
        HOME,
        half,
        max_velocity_rad_s=VELOCITY,
        max_acceleration_rad_s2=ACCELERATION,
        rng=np.random.default_rng(seed),
        **limits,
    )


def path(one, duration_s=120.0, dt_s=0.01):
    times = np.arange(0.0, duration_s, dt_s)
    pairs = [one.reference(t) for t in times]
    return times, np.array([p for p, _ in pairs]), np.array([v for _, v in pairs])


@pytest.mark.parametrize("seed", range(5))
def test_it_stays_in_the_box_and_within_the_limits(seed):
    _, positions, velocities = path(motion(seed))
    assert np.all(np.abs(positions - HOME) <= HALF + 1e-12)
    assert np.abs(velocities).max() <= VELOCITY
    assert np.abs(np.diff(velocities, axis=0)).max() / 0.01 <= ACCELERATION


def test_the_velocity_is_the_slope_of_the_position():
    _, positions, velocities = path(motion(), 10.0, 1e-3)
    slope = (positions[2:] - positions[:-2]) / 2e-3
    np.testing.assert_allclose(slope, velocities[1:-1], atol=2e-5)


def test_it_starts_at_home_at_rest():
    position, velocity = motion().reference(0.0)
    np.testing.assert_allclose(position, HOME)
    np.testing.assert_allclose(velocity, 0.0)


def test_it_visits_every_corner_of_every_pair_of_joints_evenly():
    _, positions, _ = path(motion())
    unit = (positions - HOME) / HALF
    for i in range(6):
        for j in range(i):
            counts, _, _ = np.histogram2d(unit[:, i], unit[:, j], 3, [[-1, 1], [-1, 1]])
            assert counts.min() > 0.3 * counts.mean()


def test_the_seed_decides():
    same, other = motion(3).reference(7.0)[0], motion(4).reference(7.0)[0]
    np.testing.assert_array_equal(motion(3).reference(7.0)[0], same)
    assert np.abs(same - other).max() > 0.05


def test_the_feedback_leads_a_lagging_arm_along():
    one, joints = motion(), HOME.copy()
    for k in range(3000):
        joints = joints + 0.01 * 0.9 * one.command(k * 0.01, joints)
    assert np.abs(joints - one.reference(30.0)[0]).max() < 0.1


def test_a_joint_without_range_stands_still_and_limits_cut_the_box():
    half = np.array([0.6, 0.0, 0.5, 0.5, 0.5, 0.0])
    _, positions, velocities = path(motion(half=half), 20.0)
    assert np.all(velocities[:, [1, 5]] == 0.0)
    upper = HOME + 0.2
    _, positions, _ = path(motion(upper_rad=upper), 60.0)
    assert np.all(positions <= upper + 1e-12)
    with pytest.raises(ValueError, match="outside their limits"):
        motion(upper_rad=HOME - 1.0)
