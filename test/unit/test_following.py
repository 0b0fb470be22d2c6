"""Whether joints follow: late, slow and noisy ones do, stuck and wrong ones do not."""

import numpy as np
from cases import each

from fvs_ros.following import Following

FAST, MOST_RAD_S2, FROM_S = 1.0, 6.0, 10.0


def follow(seed, lag_s, known_s, dt_s=0.008, gains=1.0, then=None, gaps=(1,)):
    """Six joints with these gains, from 10 s on with others, that are told to move to and fro.

    What was commanded since then, at most, rad, (6,), and the fault.
    """
    rng, following = np.random.default_rng(seed), Following()
    velocity, q, path, most = (np.zeros(6) for _ in range(4))
    waiting, wait = [velocity] * max(1, round(lag_s / dt_s)), 1
    goals = rng.uniform(-FAST, FAST, (60, 6)) * rng.choice([1.0, 0.05], (60, 1))
    for tick in range(round(30.0 / dt_s)):
        stamp_s = tick * dt_s
        broken = then is not None and stamp_s >= FROM_S
        waiting.append(velocity)
        q = q + dt_s * (then if broken else gains) * waiting.pop(0)
        path = path + dt_s * velocity if broken else np.zeros(6)
        most = np.maximum(most, np.abs(path))
        wait -= 1
        if not wait:  # a joint state, and its command
            wait = rng.choice(gaps)
            seen = q + 2e-4 * rng.normal(size=6)
            following.add(stamp_s + 0.001, stamp_s, velocity, seen, known_s)
            step = MOST_RAD_S2 * dt_s
            velocity = velocity + np.clip(goals[int(2.0 * stamp_s)] - velocity, -step, step)
        if following.fault:
            break
    return most, following.fault


@each("gaps", [(1,), (1, 1, 1, 2, 5, 12)])
@each(("lag_s", "known_s", "gain"), [(0.008, 0.03, 1.0), (0.04, 0.06, 0.2), (0.15, 0.2, 1.0)])
def test_joints_that_lag_within_what_is_known_or_are_slow_follow(gaps, lag_s, known_s, gain):
    assert follow(0, lag_s, known_s, gains=gain, gaps=gaps)[1] is None


@each("seed", range(2))
@each("dt_s", [0.001, 0.008])
@each("answers", [0.0, -1.0])
def test_a_joint_that_stands_or_turns_round_is_found_after_50_mrad_beyond_its_lag(
    seed, dt_s, answers
):
    then = np.ones(6)
    then[3] = answers
    most_rad, fault = follow(seed, 0.04, 0.06, dt_s, then=then)
    assert fault.joint == 3
    assert most_rad[3] < 0.055 + 0.06 * FAST
    assert abs(fault.moved_rad) < 0.15 * abs(fault.commanded_rad) or answers < 0.0
