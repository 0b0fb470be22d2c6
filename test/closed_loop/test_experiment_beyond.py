"""What is beyond the paper, measured: least time, a minute of data, moved cameras and targets."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("joblib")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from fvs_lab import beyond, beyond_verdicts
from fvs_lab.beyond_camera import (
    AT_REST,
    CARRIED,
    IN_MOTION,
    MOMENTS,
    STRUCK_AFTER_S,
    UNDISTURBED,
    Arrival,
    draw_journeys,
    run_journey,
)
from fvs_lab.beyond_minute import (
    ERRING,
    Learned,
    Minute,
    Told,
    draw_places,
    learn,
    record,
    tell,
)
from fvs_lab.beyond_results import Results
from fvs_lab.beyond_terms import (
    ACCELERATION_RAD_S2,
    ALLOCATED,
    BEST,
    BEST_ORACLE,
    CALM,
    CONTESTANTS,
    EXTENDED,
    FOLLOWERS,
    MINUTES,
    OTHERS,
    RACERS,
    SEEN,
    SLIDING,
    SLIDING_CALM,
    SPEED_RAD_S,
    TUNED,
    WORLDS,
    trial_of,
)
from fvs_lab.beyond_tracking import (
    CIRCLE,
    LINE,
    RADIUS_M,
    Pursuit,
    Tracked,
    draw_paths,
    run_pursuit,
)
from fvs_lab.context import Context
from fvs_lab.floor import Floor, Limits, fastest
from fvs_lab.report import Origin, write_page, write_report
from fvs_lab.search import SEEDS
from fvs_lab.servo_terms import REGIMES, search_of
from fvs_lab.trials import (
    BOUNDS_M,
    Case,
    Conditions,
    Outcome,
    make_cases,
    run_trial,
    simulation_of,
)
from fvs_sim_node.kinematics import ball_position
from fvs_tools.schemes import BEYOND, SCHEMES

INF = float("inf")
EXACT = Conditions(rendered=False)
COUNT = 6  # the fewest runs that decide
JOURNEYS = 73  # the fewest of which all must keep their pace to show 95 %
WORLDLY = 60  # runs in each of the other worlds


def outcome(settled_s=1.0, jitter=0.001):
    settled = None if settled_s == INF else settled_s
    times = dict.fromkeys(("5 mm", "2 mm", "1 mm"), settled)
    failure = "too slow" if settled is None else ""
    return Outcome(0.3, times, 0.0003, jitter, 1.0, 1.0, 0.0, 0.01, failure, (0.0, 0.0, 1.0))


# ---- the floor ------------------------------------------------------------------------------


def test_best_is_close_to_the_floor_and_the_same_when_repeated():
    (case,) = make_cases("t", 1, 5)
    trial = trial_of(BEST, case, EXACT, 2.0)
    one, again = run_trial(trial), run_trial(trial)
    assert one == again
    least_s = fastest(case, Limits(SPEED_RAD_S, ACCELERATION_RAD_S2), 0.005).time_s
    assert least_s < one.settled_s < 1.2 * least_s


# ---- a minute of data -----------------------------------------------------------------------


def test_images_are_stamped_late_and_the_fit_finds_out():
    minute = Minute(3, 12.0, EXACT, draw_places(1, 10), "ridge")
    data, late_s = record(minute)
    again, _ = record(minute)
    np.testing.assert_array_equal(data.ball_m, again.ball_m)
    simulation = simulation_of(EXACT)

    def error_m(shift_s):
        """Of the ball at the joints of that long before, rms."""
        joints = np.stack(
            [
                np.interp(data.stamps_s - shift_s, data.stamps_s, column)
                for column in data.joints_rad.T
            ],
            axis=1,
        )[30:]
        seen = [simulation.camera.to_camera(ball_position(one)) for one in joints]
        return np.sqrt(np.mean(np.sum((seen - data.ball_m[30:]) ** 2, axis=1)))

    assert error_m(late_s) < 0.0025 < error_m(late_s + 0.03)
    learned = learn(minute)
    assert learned.chain_box < 0.01 < learned.paper_box
    assert learned.taught_box < 0.02
    assert abs(learned.found_late_s - late_s) < 0.003


@pytest.mark.parametrize("plant", ERRING)
def test_a_fit_says_how_far_it_is_off_from_what_the_camera_sees(plant):
    conditions = replace(EXACT, **ERRING[plant])
    told = tell((plant, Minute(3, 40.0, conditions, draw_places(1, 20))))
    assert 0.5 * told.seen < told.told < 2.0 * told.seen
    # in metres, a wrong scale of the camera is not told
    assert (told.metric > 3.0 * told.told) == (plant == "depths told 0.5 % too large")


# ---- moved cameras --------------------------------------------------------------------------


def test_a_camera_that_is_struck_is_back_for_the_next_run():
    before = simulation_of(EXACT).camera
    journeys = draw_journeys(1, 7, (BEST,), EXACT)
    assert [one.moment for one in journeys] == list(MOMENTS)
    turn = np.array(journeys[0].bump.rotation_deg)
    assert np.linalg.norm(turn) == pytest.approx(45.0)
    assert abs(turn[2]) > 35.0  # mostly about the optical axis
    assert np.linalg.norm(journeys[0].bump.translation_m) == pytest.approx(0.1)
    arrivals = [run_journey(one) for one in journeys]
    np.testing.assert_array_equal(simulation_of(EXACT).camera.rotation, before.rotation)
    assert run_journey(journeys[0]) == arrivals[0]
    assert all(np.isfinite(one.settled_s) for one in arrivals)
    assert len({one.settled_s for one in arrivals}) > 1


@pytest.mark.parametrize("name", [BEST, EXTENDED])
def test_a_camera_that_moves_while_the_ball_rests_costs_little_time(name):
    settled_s = {
        one.moment: run_journey(one).settled_s for one in draw_journeys(1, 7, (name,), EXACT)
    }
    assert settled_s[AT_REST] <= 1.2 * settled_s[UNDISTURBED]
    assert settled_s[CARRIED] <= 1.2 * settled_s[UNDISTURBED]


# ---- moving targets -------------------------------------------------------------------------


def test_paths_begin_at_the_ball_and_keep_their_shape():
    line, circle = draw_paths(1, 8)
    assert (line.kind, circle.kind) == (LINE, CIRCLE)
    simulation = simulation_of(Conditions())
    for path in (line, circle):
        simulation.reset(path.start_rad)
        np.testing.assert_allclose(path.at(0.0), simulation.true_ball_position(), atol=1e-9)
        step = path.at(0.1001) - path.at(0.1)
        assert np.linalg.norm(step) == pytest.approx(0.0001, rel=1e-4)
    round_ = [circle.at(way) for way in np.linspace(0.0, 2.0 * np.pi * RADIUS_M, 9)]
    np.testing.assert_allclose(round_[0], round_[-1], atol=1e-12)
    assert np.linalg.norm(round_[4] - round_[0]) == pytest.approx(2.0 * RADIUS_M)
    assert line.duration_s(0.3) == pytest.approx(line.length_m / 0.3)


def test_feed_forward_is_what_keeps_up():
    path = draw_paths(1, 8)[1]
    pursuit = Pursuit(EXTENDED, path, 0.1, True, EXACT)
    with_it, alone = (
        run_pursuit(replace(pursuit, feed_forward=feed_forward)).rms_m
        for feed_forward in (True, False)
    )
    assert with_it < 0.003 < alone < 0.03


# ---- verdicts -------------------------------------------------------------------------------


def test_everybody_runs_with_their_own_values_and_the_same_limits():
    case = Case("", (0.0,) * 6, (0.1,) * 6, 0)
    for name, scheme in {**SCHEMES, **BEYOND}.items():
        trial = trial_of(name, case, EXACT)
        assert (trial.method, trial.law) == (scheme.method, scheme.law)
        assert trial.controller_values.items() >= scheme.controller_values.items()
    limits = {
        trial_of(name, case, EXACT).controller_values["max_joint_velocity_rad_s"]
        for name in CONTESTANTS
    }
    assert limits == {1.0}
    oracle = trial_of(BEST_ORACLE, case, EXACT)
    assert (oracle.method, oracle.law) == ("oracle", BEYOND[BEST].law)


def test_everybody_who_is_tuned_has_the_same_means():
    case = Case("", (0.0,) * 6, (0.1,) * 6, 0)
    searched = {**TUNED, **CALM}
    for scheme in searched.values():
        trial = search_of(scheme, REGIMES[0]).trial({}, case, EXACT)
        assert trial.method in ("rbf_left", "ukf", "oracle")
        allocation = trial.controller_values.get("allocation")
        assert (allocation == "least_speed") is (scheme.law in ALLOCATED)
        assert trial.controller_values["max_joint_velocity_rad_s"] == SPEED_RAD_S
    assert searched[SLIDING].law == searched[SLIDING_CALM].law == "ftsm"
    for ones in (TUNED, CALM):
        others = [ones[name] for name in OTHERS if name in ones]
        networks = {one.law for one in others if one.method == "rbf_left"}
        assert networks == {one.law for one in others} == {"proportional", "mfac", "mpc"}


def results(
    best_s=1.0,
    extended_s=1.2,
    sliding_s=1.1,
    others_s=1.3,
    struck_s=1.1,
    late_s=0.05,
    followed_m=0.001,
    slow=0,
    delayed_s=1.0,
    rest_m=0.0003,
    told=0.0003,
    lost=0,
    shaken_rad_s=0.001,
):
    """Six runs of most; the floor is 1 s, the paper's schemes take 4 s."""
    settled = {BEST: best_s, EXTENDED: extended_s}
    races = {
        name: [replace(outcome(settled.get(name, 4.0)), final_rms_m=rest_m)] * COUNT
        for name in RACERS
    }
    races |= {name: [outcome(others_s)] * COUNT * SEEDS for name in (*TUNED, *CALM)}
    races |= {name: [outcome(sliding_s)] * COUNT * SEEDS for name in (SLIDING, SLIDING_CALM)}
    arrivals = {}
    for name in (BEST, EXTENDED, BEST_ORACLE):
        arrivals[UNDISTURBED, name] = [Arrival(1.0, 1.0 - STRUCK_AFTER_S)] * JOURNEYS
        for moment in MOMENTS[1:]:
            struck = [Arrival(struck_s, struck_s - STRUCK_AFTER_S)] * (JOURNEYS - slow)
            slower = [Arrival(INF, INF)] * slow
            arrivals[moment, name] = struck + slower
    learned = Learned(1, 1800, 2.0, 0.001, 0.005, 0.005, 1.0, 0.04, 1.0, 0.05, late_s)
    path = draw_paths(1, 8)[0]
    return Results(
        minutes=[learned] * COUNT,
        told=[Told(plant, told, 0.0003, 0.005) for plant in ERRING] * COUNT,
        floors=[Floor(dict.fromkeys(BOUNDS_M, 1.0), dict.fromkeys(BOUNDS_M, 1.05))] * COUNT,
        races=races,
        rendered={
            name: races[name.removesuffix(MINUTES)]
            for name in (*SEEN, *(name + MINUTES for name in (BEST, EXTENDED)))
        },
        arrivals=arrivals,
        worlds={
            (number, name): [outcome(delayed_s if "200" in world.label else 1.0, shaken_rad_s)]
            * (WORLDLY - lost)
            + [outcome(INF)] * lost
            for number, world in enumerate(WORLDS)
            for name in FOLLOWERS
        },
        pursuits=[
            (
                Pursuit(name, path, beyond_verdicts.TRACKING_M_S, on, EXACT),
                Tracked(followed_m if on else 0.01),
            )
            for name in FOLLOWERS
            for on in (True, False)
            for _ in range(COUNT)
        ],
    )


def found(words, **changes):
    chosen = [one for one in beyond_verdicts.verdicts(results(**changes)) if words in one.claim]
    assert chosen, words
    return [one.holds for one in chosen]


def test_the_verdicts_follow_the_numbers():
    assert all(one.holds for one in beyond_verdicts.verdicts(results(struck_s=1.0)))
    assert found("physically possible", best_s=1.3) == [False]
    assert found("as published, within", extended_s=4.5) == [False]
    assert found("same means", sliding_s=1.4) == [False, False]
    assert found("same means", sliding_s=1.3) == [None, None]  # a tie
    assert found("make every scheme", others_s=4.5) == [False]
    assert found("how late", late_s=0.06) == [False]
    assert found("factor of 2", told=0.0007) == found("factor of 2", told=0.0001) == [False]
    assert found("Going along", followed_m=0.005) == [False]
    # what is left of the run counts in mid-motion: 0.8 of 0.7 s is more than 1.1 of 1 s
    assert found("between two targets", struck_s=1.1) == [True, True]
    assert found("mid-motion", struck_s=1.15) == [False, False]
    assert found("mid-motion", struck_s=INF) == [False, False]
    # one of 73 that is slower may be chance, eight are not
    assert found("between two targets", slow=1) == [None, None]
    assert found("between two targets", slow=8) == [False, False]
    assert found("of latency", delayed_s=1.09) == [True, True]
    assert found("of latency", delayed_s=1.2) == [False, False]
    assert found("At rest", rest_m=0.0005) == [False]
    # one of 60 may be chance, twelve are not
    assert found("One set of gains", lost=1) == [True]
    assert found("One set of gains", lost=3) == [None]
    assert found("One set of gains", lost=12) == [False]
    assert found("encoder noise best", shaken_rad_s=0.003) == [False]


def test_a_few_cases_cannot_show_a_share_of_95_percent():
    few = results()
    few = replace(few, arrivals={key: ones[:10] for key, ones in few.arrivals.items()})
    moved = [one for one in beyond_verdicts.verdicts(few) if "between two" in one.claim]
    assert [one.holds for one in moved] == [None, None]
    assert "10 of 10" in moved[0].finding


def test_a_run_that_leaves_nothing_to_compare_with_does_not_count_as_kept():
    for undisturbed in (Arrival(0.2, 0.2 - STRUCK_AFTER_S), Arrival(INF, INF)):
        one = results()
        one.arrivals[UNDISTURBED, BEST][0] = undisturbed
        assert np.isnan(one.slowdown(IN_MOTION, BEST)[0])
        assert one.kept(IN_MOTION, BEST) == (JOURNEYS - 1, JOURNEYS)


def test_a_blow_after_which_nobody_arrives_is_infinitely_slow():
    one = results(struck_s=INF)
    assert one.slowdown(AT_REST, BEST) == [INF] * JOURNEYS
    assert one.kept(AT_REST, BEST) == (0, JOURNEYS)
    assert results().kept(AT_REST, BEST) == (JOURNEYS, JOURNEYS)


@pytest.mark.timeout(240)
def test_a_quick_run_makes_a_complete_page(tmp_path):
    context = Context(tmp_path, jobs=2, quick=True, rendered=False, nodes=False)
    report = beyond.run(context)
    write_report(report, context.folder("beyond"), Origin("test", "", "", True))
    page = write_page(tmp_path).read_text(encoding="utf-8")
    assert '<section id="beyond">' in page
    assert page.count("data:image/png;base64,") == len(report.figures) == 5
    data = json.loads((tmp_path / "beyond" / "results.json").read_text())["data"]
    assert set(data["races"]) == {*RACERS, SLIDING, OTHERS[0]}
    assert set(data["rendered"]) == {*SEEN, BEST + MINUTES, EXTENDED + MINUTES}
    assert not [one for one in report.verdicts if one.holds]  # too few runs for that
