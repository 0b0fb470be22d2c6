"""What the additions to the paper's scheme are worth, one by one, on a plant with lag and noise."""

from __future__ import annotations

import numpy as np
import pytest
from control_plant import TICK_S, chain_of_the_arm, pairs, servo
from scipy.optimize import minimize
from ur5_dh import HOME_RAD, ball_and_jacobian

from fvs_tools.schemes import BEYOND

#: Every addition that needs no forward model.
ADDITIONS = BEYOND["extended"].controller_values
PAIRS = pairs(3, seed=11)
SPEED_RAD_S, ACCELERATION_RAD_S2 = 1.0, 6.0


def rest_s(start_rad, goal_rad):
    """Least largest travel by another library, over the speed limit, plus speed over acceleration.

    Nobody is at rest on the target sooner, since every joint starts and ends at rest.
    """
    target = ball_and_jacobian(goal_rad)[0]
    rng = np.random.default_rng(0)
    best = np.inf
    for attempt in range(6):
        guess = goal_rad - start_rad + (0.3 * rng.normal(size=6) if attempt else 0.0)
        found = minimize(
            lambda z: z[0],
            np.append(np.abs(guess).max(), guess),
            constraints=[
                {
                    "type": "eq",
                    "fun": lambda z: ball_and_jacobian(start_rad + z[1:])[0] - target,
                },
                {"type": "ineq", "fun": lambda z: np.append(z[0] - z[1:], z[0] + z[1:])},
            ],
            method="SLSQP",
        )
        if found.success:
            best = min(best, found.x[0])
    assert np.isfinite(best)
    return best / SPEED_RAD_S + SPEED_RAD_S / ACCELERATION_RAD_S2


@pytest.fixture(scope="module")
def rests_s():
    return np.array([rest_s(start, goal) for start, goal in PAIRS])


def runs(values, motions=PAIRS, **changes):
    return [
        servo(start, goal, seed=number, values=values, duration_s=3.0, **changes)
        for number, (start, goal) in enumerate(motions)
    ]


def settled_s(all_runs):
    return np.array([run.settled_s(0.005) for run in all_runs])


def test_with_a_forward_model_it_is_near_when_others_can_rest(rests_s):
    arrived = runs({"law": "arrive"}, chain=chain_of_the_arm(), jacobian_error=0.001)
    ratio = settled_s(arrived) / rests_s
    assert np.median(ratio) < 1.08
    assert ratio.max() < 1.25
    for run in arrived:
        assert run.final_rms_m < 0.0004
        # it arrives: what is overshot is below what counts as settled
        after = run.error_m[np.argmax(run.error_m < 0.005) :]
        assert after.max() < 0.005
        assert np.abs(np.diff(run.command, axis=0)).max() <= ACCELERATION_RAD_S2 * TICK_S + 1e-9
        assert np.abs(run.command).max() <= SPEED_RAD_S + 1e-9


def test_without_a_forward_model_the_same_law_does_with_the_jacobian(rests_s):
    ratio = settled_s(runs({"law": "arrive"})) / rests_s
    assert np.median(ratio) < 1.2
    assert ratio.max() < 1.6


def test_the_papers_law_with_all_additions_is_faster_and_rests_as_well():
    plain, added = runs({}), runs(ADDITIONS)
    assert np.median(settled_s(added)) < 0.93 * np.median(settled_s(plain))
    for which in (added, plain):  # of 1 mm of noise
        assert np.median([run.final_rms_m for run in which]) < 0.0003
        assert np.median([run.jitter_rad_s for run in which]) < 0.0005


@pytest.mark.parametrize("noise_m", [2e-4, 4e-3])
def test_one_default_does_for_little_and_much_noise(noise_m):
    usual, other = runs(ADDITIONS), runs(ADDITIONS, noise_m=noise_m)
    assert np.median(settled_s(other)) < 1.15 * np.median(settled_s(usual))
    assert np.median([run.final_rms_m for run in other]) < 0.4 * noise_m


def test_the_additions_are_worth_something_each():
    # Three motions do not tell: what is worth something to most costs some of them a little.
    motions = pairs(10, seed=11)
    whole_s = settled_s(runs(ADDITIONS, motions))
    for name in ("allocation", "ftsm_path"):
        without = {key: value for key, value in ADDITIONS.items() if key != name}
        without_s = settled_s(runs(without, motions))
        assert np.median(without_s / whole_s) > 1.02, name
        assert np.median(without_s) > 1.02 * np.median(whole_s), name


CENTRE_M = ball_and_jacobian(HOME_RAD)[0]


def circle(speed_m_s, radius_m=0.08):
    def at(time_s):
        angle = speed_m_s / radius_m * time_s
        return CENTRE_M + radius_m * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])

    return at


@pytest.mark.parametrize(
    ("speed_m_s", "values", "most_m"),
    [
        (0.05, {}, 0.0015),
        (0.1, {}, 0.002),
        (0.1, ADDITIONS, 0.0015),
        (0.2, {"law": "arrive"}, 0.002),
    ],
)
def test_a_target_on_a_circle_is_kept_up_with(speed_m_s, values, most_m):
    chain = chain_of_the_arm() if values.get("law") == "arrive" else None

    def rms_m(**changes):
        run = servo(
            HOME_RAD,
            HOME_RAD,
            seed=1,
            values={**values, **changes},
            duration_s=4.0,
            target_of=circle(speed_m_s),
            chain=chain,
            jacobian_error=0.01,
        )
        assert set(run.states) <= {"SERVOING", "SETTLED"}
        return float(np.sqrt(np.mean(run.error_m[run.time_s > 2.0] ** 2)))

    followed = rms_m()
    assert followed < most_m
    assert rms_m(target_feed_forward=False) > 3.0 * followed


def test_a_jacobian_of_the_wrong_sign_is_held_though_the_target_moves():
    run = servo(
        HOME_RAD,
        HOME_RAD,
        seed=1,
        duration_s=4.0,
        target_of=circle(0.05),
        turned=-np.eye(3),
    )
    assert run.states[-1] == "PREDICTION_ERROR"
    assert not run.command[-1].any()


@pytest.mark.parametrize("values", [{}, ADDITIONS])
def test_a_target_that_is_dragged_faster_than_the_arm_is_followed_when_it_stops(values):
    def dragged(time_s):
        return CENTRE_M + np.array([0.1, 0.05, 0.0]) * min(time_s, 2.0)

    slow = {"max_joint_velocity_rad_s": 0.1, "max_joint_acceleration_rad_s2": 1.0}
    run = servo(
        HOME_RAD,
        HOME_RAD,
        seed=1,
        values={**values, **slow},
        duration_s=8.0,
        target_of=dragged,
    )
    assert set(run.states) <= {"SERVOING", "SETTLED"}
    assert run.error_m.max() > 0.05
    assert run.error_m[-1] < 0.005
