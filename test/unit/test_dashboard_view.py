"""What the page says of the loop: banner, lamps, curves, picture, camera's place, tour, wishes."""

from __future__ import annotations

import socket
from math import isnan

import numpy as np
import pytest

from fvs_controller_node.config import build_loop, default_values
from fvs_controller_node.reasons import Reason, State
from fvs_dashboard import markup
from fvs_dashboard.actions import (
    CONTROLLER,
    ESTIMATOR,
    RESET,
    SET_CURRENT,
    START,
    STOP,
    Action,
    Actions,
    point_of,
)
from fvs_dashboard.board import Board, Controller, Trace
from fvs_dashboard.placement import UNKNOWN, CameraPlacement, Pose
from fvs_dashboard.tour import TargetTour
from fvs_ros.camera import Intrinsics
from fvs_sim_node.kinematics import flange_pose
from fvs_sim_node.rendering import camera_preset
from fvs_tools.schemes import BEYOND, SCHEMES

STATUS = {
    "state": "SERVOING",
    "reason": "SERVOING",
    "error_m": "0.05",
    "prediction_error_ratio": "0.1",
    "active_limit": "velocity",
    "image_latency_s": "0.041",
    "drive_lag_s": "0.0124",
    "joint_states_age_s": "0.004",
    "ball_position_age_s": "0.02",
    "jacobian_age_s": "0.5",
    "robot_program_running": "true",
    "speed_scaling_percent": "100",
    **{f"target_{a}_m": v for a, v in zip("xyz", ("0.1", "0.2", "1.5"), strict=True)},
    **{f"position_{a}_m": v for a, v in zip("xyz", ("0.07", "0.24", "1.5"), strict=True)},
}
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])


@pytest.fixture
def board():
    board = Board(ball_radius_m=0.03)
    limits_s = {"ball_max_age_s": 0.2, "joint_states_max_age_s": 0.1, "jacobian_max_age_s": 0.2}
    board.parameters[CONTROLLER] = limits_s
    return board


def test_every_key_that_is_read_is_one_that_the_controller_tells():
    loop = build_loop(default_values())
    assert set(STATUS) <= set(loop.status_values(0.0))


# --- the banner ---


def banner(sentence, **changed):
    return markup.banner_of(Controller({**STATUS, **changed}, sentence))


def test_every_state_has_a_title_and_a_colour_of_its_own():
    banners = [banner("", state=one.value, reason="") for one in State]
    banners.append(markup.banner_of(Controller({}, "")))
    assert len({one.title for one in banners}) == len(State) + 1
    assert banner("", state="DANCING").title == "Dancing"


@pytest.mark.parametrize(
    ("reason", "text", "sentence", "hint"),
    [
        ("SERVOING", "servoing, 50.0 mm to go", "", ""),
        ("SETTLED", "on target, 0.1 mm off (x publishes as well: stop it)", "x publishes", ""),
        ("READY", "ready; call ~/start to move", "", "press Start to move"),
        ("STALE", "ball is 0.3 s old; is it seen?", "ball is 0.3 s old", "is it seen?"),
    ],
)
def test_the_banner_says_each_thing_once_and_in_the_pages_words(reason, text, sentence, hint):
    shown = banner(text, reason=reason)
    assert shown.sentence.startswith(sentence)
    assert bool(shown.sentence) == bool(sentence)
    assert shown.hint == hint


def test_no_reason_asks_for_a_service_that_the_page_has_a_button_for():
    for reason in Reason:
        assert "~/" not in markup.in_words(reason.text), reason


@pytest.mark.parametrize("others", ["", "; x publishes as well"])
def test_a_refused_target_is_not_in_the_banner(others):
    refused = "target refused: z = 9 m; (too far)"
    shown = banner(f"held; why ({refused}{others})", reason="STALE", refused_target=refused)
    assert "refused" not in shown.sentence + shown.hint
    assert "x publishes" in shown.hint or not others


@pytest.mark.parametrize(
    ("error_m", "text"), [(0.00012, "0.12 mm"), (0.3, "300 mm"), (float("nan"), "–")]
)
def test_a_distance_in_words(error_m, text):
    assert markup.distance(error_m) == text


def test_what_comes_from_outside_is_no_markup():
    evil = "<b>x</b>"
    shown = markup.Banner(evil, evil, "#000", evil, evil)
    for html in (
        markup.banner_html(shown, 0.1),
        markup.line_html("answer", evil, 2),
        markup.notes_html([evil]),
        markup.inputs_html([markup.Lamp(evil, True, evil)], {evil: evil}),
    ):
        assert "<b>x" not in html
        assert "&lt;b&gt;x" in html


# --- lamps, details, scheme ---


def test_lamps_follow_the_controllers_ages_and_else_ones_own(board):
    board.add_status(0.0, STATUS, "")
    lamps = {lamp.name: lamp for lamp in markup.lamps_of(board, 0.0)}
    assert [lamp.good for lamp in lamps.values()] == [True, True, False, True]
    assert lamps["Robot program"].text == "runs, 100 %"
    board.add_ball(9.0, 10.0, np.ones(3))
    alone = {lamp.name: lamp for lamp in markup.lamps_of(board, 9.03)}
    assert alone["Ball seen"] == markup.Lamp("Ball seen", None, "30 ms ago")
    assert alone["Joint states"] == markup.Lamp("Joint states", None, "unknown")
    assert alone["Robot program"].good is None


@pytest.mark.parametrize(
    ("changed", "good"),
    [
        ({"robot_program_running": "false"}, False),
        ({"robot_program_running": "unknown"}, None),
        ({"speed_scaling_percent": "0"}, False),
    ],
)
def test_a_robot_that_does_not_obey_is_seen(board, changed, good):
    board.add_status(0.0, {**STATUS, **changed}, "")
    assert markup.lamps_of(board, 0.0)[-1].good is good


def test_what_the_troubleshooting_asks_for_stands_there_as_far_as_it_is_known(board):
    board.add_status(0.0, STATUS, "")
    board.add_detector(0.0, "no red ball in the image")
    assert markup.details_of(board, 0.5) == {
        "Image latency": "41 ms",
        "Drive lag": "12 ms",
        "Active limit": "velocity",
        "Detector": "no red ball in the image",
    }
    assert markup.details_of(board, 9.0) == {}


def test_the_scheme_that_runs_is_named(board):
    assert markup.scheme_of(board) == "unknown"
    for scheme in (*SCHEMES.values(), *BEYOND.values()):
        board.parameters[ESTIMATOR] = {"method": scheme.method}
        board.parameters[CONTROLLER] = {"law": scheme.law, **scheme.controller_values}
        assert markup.scheme_of(board) == scheme.name
    board.parameters[CONTROLLER] = {"law": "mpc"}
    assert markup.scheme_of(board) == "poe with mpc"


# --- what is known, and for how long ---


def test_a_trace_forgets_what_is_old_and_begins_anew_with_the_clock():
    trace = Trace(2.0, 1)
    assert trace.window(0.0).shape == (0, 2)
    for t in (0.0, 1.0, 2.5):
        trace.add(t, [t])
    trace.add(2.6, [float("nan")])
    np.testing.assert_allclose(trace.window(3.0), [[-2.0, 1.0], [-0.5, 2.5]])
    for t in (500.0, 100.0, 99.9):  # the last one is but late
        trace.add(t, [t])
    np.testing.assert_allclose(trace.rows[:, 0], [100.0, 99.9])


def test_a_silent_controller_shows_within_a_second_or_so(board):
    assert board.controller(0.0).silent
    board.add_status(0.0, STATUS, "servoing")
    assert board.controller(0.9).sentence == "servoing"
    gone = board.controller(3.0)
    assert gone.silent
    assert gone.sentence == "no word from the controller for 3 s"
    assert gone.target_m is None
    assert isnan(gone.error_m)


def test_curves_are_in_millimetres_never_zero_and_only_of_what_is_so(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    board.add_joints(0.0, 10.0, np.zeros(6), np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.5]))
    board.sample(0.0)
    board.sample(5.0)  # without joint states
    board.add_status(0.0, STATUS, "")
    board.add_status(1.1, STATUS, "")  # without a ball
    np.testing.assert_allclose(board.error_mm.window(1.1)[0], [-1.1, 50.0, 30.0, 40.0, 1e-3])
    np.testing.assert_allclose(board.speed_rad_s.window(1.1), [[-1.1, 0, 1, 0, 0, 0, 0.5]])
    np.testing.assert_allclose(board.ratio.window(1.1), [[-1.1, 0.1]])


def test_a_ball_long_gone_is_not_shown_and_its_trail_fades(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    assert board.ball_m(0.1) is not None
    assert board.ball_m(1.0) is None
    assert len(board.trail_m.window(1.0)) == 1
    assert len(board.trail_m.window(7.0)) == 0


def test_what_the_page_says_of_itself_takes_no_answer_away(board):
    board.answer(0.0, "stop: stopping")
    board.note("behind", "it is behind", until_s=5.0)
    assert board.answered(1.0) == "stop: stopping"
    assert board.notes(1.0) == [UNKNOWN, "it is behind"]
    assert board.notes(6.0) == [UNKNOWN]
    assert board.answered(60.0) == ""


# --- the picture ---


def test_an_empty_picture_says_what_it_waits_for_and_an_old_one_its_age(board):
    board.waits_for = "no picture: no node publishes camera/color/image_raw"
    empty = board.picture(0.0)
    assert (empty > 200).any()
    assert board.picture(0.1) is None  # the same
    board.add_image(0.2, 10.0, np.full((480, 640, 3), 200, np.uint8))
    assert (board.picture(0.3) == 200).all()
    assert board.picture(2.0) is None
    shown = [board.picture(now_s) for now_s in (2.8, 2.9, 3.8)]
    assert [one is None for one in shown] == [False, True, False]
    assert all(np.median(one) == 70 for one in (shown[0], shown[2]))
    assert (shown[0] != shown[2]).any()


def test_the_ball_is_circled_where_the_image_shows_it(board):
    board.set_intrinsics(CAMERA)
    board.add_ball(0.0, 10.0, np.array([0.0, 0.0, 1.2]))
    board.add_ball(0.1, 10.1, np.array([0.3, 0.0, 1.2]))

    def yellow(stamp_s):
        board.add_image(0.0, stamp_s, np.zeros((480, 640, 3), np.uint8))
        picture = board.picture(1.0).astype(int)
        return np.argwhere(picture[..., :2].min(axis=2) - picture[..., 2] > 60)[:, 1]

    for stamp_s, column in ((10.0, 159.5), (10.1, 234.5)):
        assert yellow(stamp_s).mean() == pytest.approx(column, abs=0.7)
    assert not len(yellow(11.0))


# --- where the camera is ---


def sweep(placement, camera, steps, noise_m=0.0):
    """Let the arm move and the camera look on."""
    rng = np.random.default_rng(1)
    for t in np.arange(steps) / 10.0:
        flange = flange_pose(HOME + 0.4 * np.sin(t * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9])))
        ball = flange[:3, 3] + 0.09 * flange[:3, 2]
        seen = camera.rotation.T @ (ball - camera.position_m)
        placement.add(flange, seen + noise_m * rng.normal(size=3))


def test_the_cameras_place_is_learned_and_learned_anew_when_it_was_moved():
    placement, front, overhead = CameraPlacement(), *map(camera_preset, ("front", "overhead"))
    for _ in range(50):
        placement.add(flange_pose(HOME), np.array([0.0, 0.1, 1.4]))
    assert placement.note == UNKNOWN  # an arm that stands tells nothing
    sweep(placement, front, 200, noise_m=0.001)
    np.testing.assert_allclose(placement.pose.position_m, front.position_m, atol=0.02)
    assert "learned" in placement.note
    before = placement.pose.position_m
    placement.add(flange_pose(np.zeros(6)), np.array([0.5, 0.5, 3.0]))  # a wrong detection
    np.testing.assert_array_equal(placement.pose.position_m, before)
    sweep(placement, overhead, 8)
    assert placement.pose is None
    sweep(placement, overhead, 200)
    np.testing.assert_allclose(placement.pose.position_m, overhead.position_m, atol=1e-4)
    np.testing.assert_allclose(placement.pose.rotation, overhead.rotation, atol=1e-4)


def test_who_knows_is_believed(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    pose = Pose(np.eye(3), np.ones(3))
    board.tell_camera(pose)  # bumped: what was seen before is elsewhere now
    assert board.placement.pose is pose
    assert board.notes(0.0) == []
    assert len(board.trail_m.window(0.0)) == 0


def test_the_board_learns_from_the_joints_at_the_exposure(board):
    front = camera_preset("front")

    def joints(t_s):
        return HOME + 0.4 * np.sin(t_s * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))

    for k in range(1500):
        stamp_s = 0.008 * k
        board.add_joints(stamp_s, stamp_s, joints(stamp_s), np.zeros(6))
        if k >= 5 and k % 4 == 0:  # exposed between two joint states 40 ms ago
            flange = flange_pose(joints(stamp_s - 0.036))
            ball = flange[:3, 3] + 0.09 * flange[:3, 2]
            seen = front.rotation.T @ (ball - front.position_m)
            board.add_ball(stamp_s, stamp_s - 0.036, seen)
            board.learn_camera(flange_pose)
    np.testing.assert_allclose(board.placement.pose.position_m, front.position_m, atol=0.002)


# --- the tour ---


def test_the_tour_waits_for_the_loop_and_gives_each_target_its_time():
    candidates = np.random.default_rng(0).uniform(-0.4, 0.4, (500, 3)) + [0.0, 0.2, 1.4]
    tour, ball = TargetTour(candidates, period_s=5.0), np.array([0.0, 0.2, 1.4])
    assert tour.next(0.0, ready=False, ball_m=ball) is None
    assert tour.next(0.0, ready=True, ball_m=None) is None
    first = tour.next(1.0, ready=True, ball_m=ball)
    assert np.linalg.norm(first - ball) == pytest.approx(0.3, abs=0.03)
    assert tour.next(5.9, ready=True, ball_m=first) is None
    assert tour.next(6.0, ready=True, ball_m=first) is not None


def test_a_tour_that_lost_the_ball_says_so_once():
    tour, ball = TargetTour(np.zeros((1, 3)), period_s=5.0), np.zeros(3)
    assert not tour.lost(100.0, None), "there was none yet"
    assert not tour.lost(101.0, ball)
    told = [tour.lost(now_s, None) for now_s in (105.0, 108.9, 109.1, 110.0, 140.0)]
    assert told == [False, False, True, False, False]


@pytest.mark.parametrize(
    ("changed", "goes"),
    [
        ({}, True),
        ({"state": "READY", "reason": "READY"}, False),
        ({"state": "WAITING", "reason": "NO_TARGET"}, True),
        ({"state": "HOLDING", "reason": "STALLED"}, False),
    ],
)
def test_when_a_target_would_be_gone_to(changed, goes):
    assert Controller({**STATUS, **changed}, "").goes_to_targets is goes


# --- what a person does ---


def after(*said):
    actions = Actions()
    for action in said:
        actions.put(action)
    return actions.drain()


def test_actions_come_in_order_and_of_slid_values_the_last():
    near, far = Action("target", (0, 0, 1)), Action("target", (0, 0, 2))
    tour, noise = Action("tour", True), Action("fvs_sim_node/depth_noise", 2.0)
    said = START, near, Action("fvs_sim_node/depth_noise", 1.0), tour, far, noise
    assert after(*said) == [START, tour, far, noise]


@pytest.mark.parametrize("stop", [STOP, RESET])
def test_a_stop_comes_first_and_nothing_wanted_before_it_moves_the_arm(stop):
    near, far = Action("target", (0, 0, 1)), Action("target", (0, 0, 2))
    late = Action("fvs_sim_node/latency_s", 0.1)
    said = START, near, late, SET_CURRENT, Action("tour", True), stop, far
    assert after(*said) == [stop, late, far]


def test_who_does_the_actions_is_woken_when_the_action_is_there():
    heard = []
    actions = Actions(lambda: heard.append(actions.drain()))
    actions.put(START)
    actions.put(STOP)
    assert heard == [[START], [STOP]]


def test_no_line_joins_what_is_before_and_after_a_gap():
    charts = pytest.importorskip("fvs_dashboard.charts")
    nan, time_s = np.nan, np.array([0.0, 0.1, 2.1, 2.2, 2.3])
    values = charts.since_gap(time_s, np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    np.testing.assert_array_equal(values, [nan, nan, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(charts.since_gap(0.1 * time_s, time_s), time_s)


@pytest.mark.parametrize("text", ["0.1, 0.2, 1.5", " .1 .2 1.5 ", "0.1;0.2;1.5"])
def test_a_typed_position(text):
    assert point_of(text) == (0.1, 0.2, 1.5)


@pytest.mark.parametrize("text", ["", "1, 2", "1, 2, 3, 4", "1, 2, nan", "a b c"])
def test_what_is_no_position_is_said_to_be_none(text):
    with pytest.raises(ValueError, match="three numbers in metres"):
        point_of(text)


# --- who is let in ---


@pytest.mark.parametrize(
    ("served_at", "host", "origin", "words"),
    [
        ("127.0.0.1", "localhost:8080", None, ""),
        ("127.0.0.1", "127.0.0.1:9090", "http://127.0.0.1:9090", ""),  # through a tunnel
        ("127.0.0.1", "[::1]:8080", "http://[::1]:8080", ""),
        ("127.0.0.1", "localhost:8080", "http://localhost:3000", "may not command this arm"),
        ("127.0.0.1", "localhost:8080", "null", "may not command this arm"),
        ("127.0.0.1", "evil.example:8080", "http://evil.example:8080", "not served as evil.ex"),
        ("127.0.0.1", "", None, "not served as"),
        ("0.0.0.0", "192.168.1.7:8080", "http://192.168.1.7:8080", ""),
        ("0.0.0.0", "[fe80::7]:8080", "http://[fe80::7]:8080", ""),
        ("0.0.0.0", "{own}.local:8080", "http://{own}.local:8080", ""),
        # a name that was made to point here
        ("0.0.0.0", "evil.example:8080", "http://evil.example:8080", "not served as evil.ex"),
        ("0.0.0.0", "", None, "not served as"),
    ],
)
def test_only_the_page_itself_may_command_and_under_its_own_name(served_at, host, origin, words):
    guard = pytest.importorskip("fvs_dashboard.guard")
    own = socket.gethostname()
    headers = {"Host": host.format(own=own)}
    if origin is not None:
        headers["Origin"] = origin.format(own=own)
    addresses = served_at in guard.EVERYWHERE
    reason = guard.objection(headers, guard.own_names(served_at), addresses=addresses)
    assert words in reason
    assert bool(reason) == bool(words)
