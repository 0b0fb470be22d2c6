"""What the page says of the loop: states in words, lamps, curves, camera's place, tour, wishes."""

from __future__ import annotations

import socket
from math import inf

import numpy as np
import pytest

from fvs_controller_node.config import build_loop, default_values
from fvs_controller_node.reasons import State
from fvs_ros.apps.dashboard import markup, view
from fvs_ros.apps.dashboard.actions import (
    SET_CURRENT,
    START,
    STOP,
    Actions,
    Disturb,
    Target,
    Tour,
    point_of,
)
from fvs_ros.apps.dashboard.board import Board, Trace
from fvs_ros.apps.dashboard.picture import with_age
from fvs_ros.apps.dashboard.placement import UNKNOWN, CameraPlacement, Pose
from fvs_ros.apps.dashboard.tour import TargetTour
from fvs_ros.core.camera import Intrinsics
from fvs_ros.core.quaternions import rotation_of
from fvs_sim_node.kinematics import flange_pose
from fvs_sim_node.rendering import camera_preset

STATUS = {
    "state": "SERVOING",
    "reason": "SERVOING",
    "settled": "false",
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
    **{f"exponent_{a}": "1.2" for a in "xyz"},
}


@pytest.fixture
def board():
    return Board(history_s=10.0, trail_s=2.0, ball_radius_m=0.03)


# --- the controller's word ---


def test_every_key_that_is_read_is_one_that_the_controller_tells():
    told = build_loop(default_values()).status_values(0.0)
    assert set(STATUS) <= set(told)


def test_a_status_is_read_and_what_is_unknown_stays_unknown():
    seen = view.ControllerView.of(STATUS, "servoing, 50.0 mm to go")
    assert (seen.state, seen.error_m, seen.program_running) == ("SERVOING", 0.05, True)
    np.testing.assert_allclose(seen.error_xyz_m, [0.03, -0.04, 0.0])
    empty = view.ControllerView.of({"state": "WAITING", "error_m": "unknown"}, "no joint_states")
    assert np.isnan(empty.error_m)
    assert empty.target_m is None
    assert empty.error_xyz_m is None


def test_every_state_has_a_title_of_its_own():
    known = [view.ControllerView(state=one.value, sentence="so it is") for one in State]
    banners = [view.banner_of(one) for one in [view.ControllerView(), *known]]
    assert len({banner.title for banner in banners}) == len(State) + 1
    assert {banner.sentence for banner in banners[1:]} == {"so it is"}
    odd = view.banner_of(view.ControllerView(state="DANCING"))
    assert (odd.title, odd.state) == ("Dancing", "DANCING")


def test_on_target_is_told_from_on_the_way():
    on_way = view.banner_of(view.ControllerView.of(STATUS, ""))
    there = view.banner_of(view.ControllerView.of({**STATUS, "settled": "true"}, ""))
    assert on_way.title != there.title


@pytest.mark.parametrize(
    ("error_m", "text"), [(0.00012, "0.12 mm"), (0.3, "300 mm"), (float("nan"), "–")]
)
def test_a_distance_in_words(error_m, text):
    assert view.distance(error_m) == text


MAX_AGES_S = {"ball_position": 0.2, "joint_states": 0.1, "jacobian": 0.2}


def test_lamps_follow_the_controllers_ages_and_else_ones_own():
    lamps = {
        lamp.name: lamp
        for lamp in view.lamps_of(view.ControllerView.of(STATUS, ""), {}, MAX_AGES_S)
    }
    assert lamps["Ball seen"].good
    assert lamps["Joint states"].good
    assert lamps["Jacobian"].good is False
    assert lamps["Robot program"] == view.Lamp("Robot program", True, "runs, 100 %")
    silent = view.ControllerView()
    alone = {lamp.name: lamp for lamp in view.lamps_of(silent, {"ball_position": 0.03}, MAX_AGES_S)}
    assert alone["Ball seen"] == view.Lamp("Ball seen", None, "30 ms ago")
    assert alone["Joint states"] == view.Lamp("Joint states", None, "unknown")
    assert alone["Robot program"].good is None


@pytest.mark.parametrize(
    ("changed", "good"),
    [
        ({"robot_program_running": "false"}, False),
        ({"robot_program_running": "unknown"}, None),
        ({"speed_scaling_percent": "0"}, False),
    ],
)
def test_a_robot_that_does_not_obey_is_seen(changed, good):
    lamps = view.lamps_of(view.ControllerView.of({**STATUS, **changed}, ""), {}, MAX_AGES_S)
    assert lamps[-1].good is good


def test_what_the_troubleshooting_asks_for_stands_there_as_far_as_it_is_known(board):
    board.add_status(0.0, STATUS, "")
    board.add_detector(0.0, "no red ball in the image")
    details = board.snapshot(0.5, tour=False).details
    assert [(one.name, one.text) for one in details] == [
        ("Image latency", "41 ms"),
        ("Drive lag", "12 ms"),
        ("Active limit", "velocity"),
        ("Detector", "no red ball in the image"),
    ]
    html = markup.details_html(details)
    assert "no red ball in the image" in html
    unknown = {"state": "WAITING", "image_latency_s": "unknown", "active_limit": ""}
    board.add_status(4.0, unknown, "")  # and no word from the detector since
    assert board.snapshot(4.0, tour=False).details == (view.Detail("Active limit", "none"),)
    assert board.snapshot(9.0, tour=False).details == ()


def test_what_comes_from_outside_is_no_markup():
    banner = view.Banner("t", "#000", "FAULT", "<script>alert(1)</script>", "–")
    html = markup.banner_html(banner)
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
    assert "<b>x" not in markup.answer_html("<b>x</b>")
    assert "<b>x" not in markup.notes_html(("<b>x</b>",))
    assert "<b>x" not in markup.lamps_html((view.Lamp("<b>x</b>", True, "<b>x</b>"),))
    assert "<b>x" not in markup.details_html((view.Detail("<b>x</b>", "<b>x</b>"),))


def test_a_service_that_the_controller_asks_for_is_called_by_its_button():
    html = markup.banner_html(view.Banner("t", "#000", "READY", "ready; call ~/start to move", "–"))
    assert "press Start to move" in html
    assert "~/" not in html


# --- the board ---


def test_a_trace_forgets_what_is_old_and_leaves_out_what_is_unknown():
    trace = Trace(2.0, 1)
    assert trace.window(0.0).shape == (0, 2)
    for t in (0.0, 1.0, 2.5):
        trace.add(t, [t])
    trace.add(2.6, [float("nan")])
    np.testing.assert_allclose(trace.window(3.0), [[-2.0, 1.0], [-0.5, 2.5]])


def test_a_trace_begins_anew_when_the_clock_was_set_back():
    trace = Trace(2.0, 1)
    for t in (500.0, 500.1, 100.0, 99.9):  # the last one is but late
        trace.add(t, [t])
    np.testing.assert_allclose(trace.rows[:, 0], [100.0, 99.9])


def test_a_silent_controller_shows_within_a_second_or_so(board):
    assert board.snapshot(0.0, tour=False).banner.state == "SILENT"
    board.add_status(0.0, STATUS, "servoing")
    assert board.snapshot(0.9, tour=False).banner.sentence == "servoing"
    gone = board.snapshot(3.0, tour=False)
    assert gone.controller.silent
    assert gone.banner.sentence == "no word from the controller for 3 s"
    assert gone.controller.target_m is None


def test_curves_are_in_millimetres_and_never_zero(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    board.add_status(0.0, {**STATUS, "error_m": "0.05"}, "")
    board.add_joints(0.0, 10.0, np.zeros(6), np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.5]))
    board.sample(0.0)
    curves = board.snapshot(0.5, tour=False).curves
    np.testing.assert_allclose(curves.error_mm, [[-0.5, 50.0, 30.0, 40.0, 1e-3]])
    np.testing.assert_allclose(curves.speed_rad_s, [[-0.5, 0, 1, 0, 0, 0, 0.5]])
    np.testing.assert_allclose(curves.ratio, [[-0.5, 0.1]])
    board.add_status(0.6, {**STATUS, "prediction_error_ratio": "0"}, "")
    np.testing.assert_allclose(board.snapshot(0.6, tour=False).curves.ratio[-1], [0.0, 1e-4])
    np.testing.assert_allclose(curves.exponent, [[-0.5, 1.2, 1.2, 1.2]])


def test_without_joint_states_no_speeds_are_noted(board):
    board.add_joints(0.0, 10.0, np.zeros(6), np.ones(6))
    board.sample(0.5)
    board.sample(5.0)
    assert len(board.snapshot(5.0, tour=False).curves.speed_rad_s) == 1


def test_without_a_ball_the_prediction_error_is_no_news(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    for now_s in (0.5, 0.9, 1.1, 9.0):
        board.add_status(now_s, STATUS, "")
    assert len(board.snapshot(9.0, tour=False).curves.ratio) == 2
    assert len(board.snapshot(9.0, tour=False).curves.error_mm) == 4


def test_a_ball_long_gone_is_not_shown_and_its_trail_fades(board):
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    assert board.snapshot(0.1, tour=False).ball_m is not None
    later = board.snapshot(1.0, tour=False)
    assert later.ball_m is None
    assert len(later.trail_m) == 1
    assert len(board.snapshot(3.0, tour=False).trail_m) == 0


def test_an_image_is_given_out_once_and_an_answer_for_a_while(board):
    board.set_intrinsics(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    board.add_image(0.0, 10.0, np.zeros((480, 640, 3), np.uint8))
    board.answer(0.0, "start: servoing")
    first = board.snapshot(0.0, tour=False)
    assert first.picture.shape == (240, 320, 3)
    assert first.answer == "start: servoing"
    assert first.field_of_view == pytest.approx((2 * np.arctan(0.4), 4 / 3))
    assert board.snapshot(0.1, tour=False).picture is None
    assert board.snapshot(60.0, tour=False).answer == ""


def test_what_the_page_says_of_itself_takes_no_answer_away(board):
    board.answer(0.0, "stop: stopping")
    board.note("behind", "it is behind", until_s=5.0)
    board.note("tour", "the tour waits")
    shown = board.snapshot(1.0, tour=False)
    assert shown.answer == "stop: stopping"
    assert shown.notes == (UNKNOWN, "it is behind", "the tour waits")
    board.note("tour", "")
    assert board.snapshot(6.0, tour=False).notes == (UNKNOWN,)


def drawn(board, exposed_s, stamp_s, now_s):
    """Where in the picture of an image there is what colour: columns of blue and of white."""
    board.add_image(exposed_s, stamp_s, np.zeros((480, 640, 3), np.uint8))
    picture = board.snapshot(now_s, tour=False).picture.astype(int)
    blue = np.argwhere(picture[..., 2] - picture[..., 0] > 60)[:, 1]
    white = np.argwhere(picture.min(axis=2) > 100)[:, 1]
    return blue, white


def test_a_late_image_shows_the_target_and_the_trail_of_its_own_time(board):
    board.set_intrinsics(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    for k in range(20):  # to the right at 0.2 m/s, down to the middle of the image
        board.add_ball(0.1 * k, 100.0 + 0.1 * k, np.array([0.02 * k, 0.0, 1.2]))
    for now_s, x in ((0.0, -0.2), (1.0, -0.4), (1.9, 0.6)):
        values = {"target_x_m": str(x), "target_y_m": "0.3", "target_z_m": "1.2"}
        board.add_status(now_s, {**STATUS, **values}, "")
    blue, white = drawn(board, exposed_s=1.2, stamp_s=101.2, now_s=1.9)
    assert blue.mean() == pytest.approx(159.5 - 300 * 0.4 / 1.2, abs=1.0)
    assert white.max() == pytest.approx(159.5 + 300 * 0.24 / 1.2, abs=2.0)
    board.tell_camera(Pose(np.eye(3), np.zeros(3)))
    blue, white = drawn(board, exposed_s=0.5, stamp_s=100.5, now_s=1.9)
    assert blue.mean() == pytest.approx(159.5 - 300 * 0.2 / 1.2, abs=1.0)
    assert white.max() == pytest.approx(159.5 + 300 * 0.10 / 1.2, abs=2.0)
    board.tell_camera(Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3)))  # bumped
    blue, white = drawn(board, exposed_s=1.2, stamp_s=101.2, now_s=1.9)
    assert len(blue)
    assert not len(white)


def test_the_ball_is_circled_where_the_image_shows_it(board):
    board.set_intrinsics(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    board.add_ball(0.0, 10.0, np.array([0.0, 0.0, 1.2]))
    board.add_ball(0.1, 10.1, np.array([0.3, 0.0, 1.2]))

    def yellow(stamp_s):
        board.add_image(0.0, stamp_s, np.zeros((480, 640, 3), np.uint8))
        picture = board.snapshot(1.0, tour=False).picture.astype(int)
        return np.argwhere(picture[..., :2].min(axis=2) - picture[..., 2] > 60)[:, 1]

    for stamp_s, column in ((10.0, 159.5), (10.1, 234.5)):
        assert yellow(stamp_s).mean() == pytest.approx(column, abs=0.7)
    assert not len(yellow(11.0))


def test_a_picture_that_is_not_of_now_is_dark_and_tells_its_age(board):
    assert board.picture_age_s(3.0) == inf
    board.add_image(0.0, 10.0, np.full((480, 640, 3), 200, np.uint8))
    assert board.picture_age_s(1.0) == 1.0
    assert (board.snapshot(1.0, tour=False).picture == 200).all()
    assert board.snapshot(1.9, tour=False).picture is None
    shown = [board.snapshot(now_s, tour=False) for now_s in (2.6, 2.9, 3.4, 3.6, 12.0)]
    assert [one.picture is None for one in shown] == [False, True, True, False, False]
    assert [one.picture_old_s for one in shown if one.picture is not None] == [3, 4, 12]
    for one in shown:
        assert one.picture is None or (one.picture == 70).all()
    words = [with_age(shown[0].picture, age_s) for age_s in (3, 4)]
    assert all((one > 240).any() for one in words)
    assert (words[0] != words[1]).any()
    assert with_age(shown[0].picture, 0) is shown[0].picture
    board.add_image(12.0, 22.0, np.full((480, 640, 3), 200, np.uint8))
    young = board.snapshot(12.1, tour=False)
    assert (young.picture == 200).all()
    assert young.picture_old_s == 0
    board.add_image(7.0, 17.0, np.full((480, 640, 3), 200, np.uint8))  # five seconds late
    assert np.median(board.snapshot(12.2, tour=False).picture) == 70


def test_where_a_target_was_too_long_ago_to_know_none_is_drawn(board):
    board.set_intrinsics(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    values = {"target_x_m": "0.0", "target_y_m": "0.3", "target_z_m": "1.2"}
    board.add_status(20.0, {**STATUS, **values}, "")
    blue, _ = drawn(board, exposed_s=20.1, stamp_s=100.0, now_s=20.2)
    assert len(blue)
    blue, _ = drawn(board, exposed_s=19.0, stamp_s=99.0, now_s=20.2)
    assert not len(blue)


# --- where the camera is ---


def sweep(placement, camera, steps, noise_m=0.0):
    """Let the arm move and the camera look on."""
    rng = np.random.default_rng(1)
    for t in np.arange(steps) / 10.0:
        wave = np.sin(t * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))
        flange = flange_pose(np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0]) + 0.4 * wave)
        ball = flange[:3, 3] + 0.09 * flange[:3, 2]
        seen = camera.rotation.T @ (ball - camera.position_m)
        placement.add(flange, seen + noise_m * rng.normal(size=3))


def test_the_cameras_place_is_learned_and_learned_anew_when_it_was_moved():
    placement = CameraPlacement()
    assert placement.pose is None
    assert placement.note == UNKNOWN
    front = camera_preset("front")
    sweep(placement, front, 200, noise_m=0.001)
    np.testing.assert_allclose(placement.pose.position_m, front.position_m, atol=0.02)
    assert "learned" in placement.note
    overhead = camera_preset("overhead")
    sweep(placement, overhead, 8)
    assert placement.pose is None
    sweep(placement, overhead, 200)
    np.testing.assert_allclose(placement.pose.position_m, overhead.position_m, atol=0.02)


def test_one_wrong_detection_moves_no_camera():
    placement, front = CameraPlacement(), camera_preset("front")
    sweep(placement, front, 200)
    before = placement.pose.position_m
    placement.add(flange_pose(np.zeros(6)), np.array([0.5, 0.5, 3.0]))
    np.testing.assert_array_equal(placement.pose.position_m, before)


def test_who_knows_is_believed(board):
    pose = Pose(rotation_of(np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])), np.ones(3))
    np.testing.assert_allclose(pose.rotation[:2, 0], [np.cos(0.6), np.sin(0.6)])
    board.add_ball(0.0, 10.0, np.array([0.0, 0.1, 1.4]))
    board.tell_camera(pose)
    assert board.snapshot(0.0, tour=False).camera is pose
    assert board.snapshot(0.0, tour=False).notes == ()
    assert len(board.snapshot(0.0, tour=False).trail_m) == 1
    board.tell_camera(Pose(np.eye(3), np.ones(3)))  # bumped: what was seen before is elsewhere now
    assert len(board.snapshot(0.0, tour=False).trail_m) == 0


def test_the_board_learns_from_the_joints_at_the_exposure(board):
    front = camera_preset("front")
    for k in range(1500):
        stamp_s = 0.008 * k
        wave = np.sin(stamp_s * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))
        joints = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0]) + 0.4 * wave
        board.add_joints(stamp_s, stamp_s, joints, np.zeros(6))
        if k >= 5 and k % 4 == 0:
            # Exposed between two joint states 40 ms ago.
            exposed_s = stamp_s - 0.036
            wave = np.sin(exposed_s * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))
            flange = flange_pose(np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0]) + 0.4 * wave)
            ball = flange[:3, 3] + 0.09 * flange[:3, 2]
            seen = front.rotation.T @ (ball - front.position_m)
            board.add_ball(stamp_s, exposed_s, seen)
            board.learn_camera(flange_pose)
    found = board.snapshot(12.0, tour=False).camera
    np.testing.assert_allclose(found.position_m, front.position_m, atol=0.002)


# --- the tour ---


def test_the_tour_waits_for_the_loop_and_gives_each_target_its_time():
    candidates = np.random.default_rng(0).uniform(-0.4, 0.4, (500, 3)) + [0.0, 0.2, 1.4]
    tour = TargetTour(candidates, period_s=5.0, distance_m=0.3, seed=3)
    ball = np.array([0.0, 0.2, 1.4])
    assert tour.next(0.0, ready=False, ball_m=ball) is None
    assert tour.next(0.0, ready=True, ball_m=None) is None
    first = tour.next(1.0, ready=True, ball_m=ball)
    assert np.linalg.norm(first - ball) == pytest.approx(0.3, abs=0.03)
    assert tour.next(5.9, ready=True, ball_m=first) is None
    second = tour.next(6.0, ready=True, ball_m=first)
    assert np.linalg.norm(second - first) == pytest.approx(0.3, abs=0.03)


def test_a_tour_that_waits_long_is_called_so_until_it_goes_on():
    tour = TargetTour(np.zeros((1, 3)), period_s=5.0, distance_m=0.3, seed=3)
    told = [tour.waits(now_s, ready=False) for now_s in (100.0, 105.0, 110.5, 120.0, 140.0)]
    assert told == [False, False, True, True, True]
    assert not tour.waits(141.0, ready=True)
    assert not tour.waits(150.0, ready=False)
    assert tour.waits(152.0, ready=False)


def test_a_tour_that_lost_the_ball_says_so_once():
    tour = TargetTour(np.zeros((1, 3)), period_s=5.0, distance_m=0.3, seed=3)
    ball = np.zeros(3)
    assert not tour.lost(100.0, None), "there was none yet"
    assert not tour.lost(101.0, ball)
    told = [tour.lost(now_s, None) for now_s in (105.0, 108.9, 109.1, 110.0, 140.0)]
    assert told == [False, False, True, False, False]
    assert not tour.lost(141.0, ball)
    assert tour.lost(149.5, None)


@pytest.mark.parametrize(
    ("changed", "goes"),
    [
        ({}, True),
        ({"state": "READY", "reason": "READY"}, False),
        ({"state": "WAITING", "reason": "NO_TARGET"}, True),
        ({"state": "WAITING", "reason": "STALE"}, False),
        ({"state": "HOLDING", "reason": "STALLED"}, False),
    ],
)
def test_when_a_target_would_be_gone_to(changed, goes):
    assert view.ControllerView.of({**STATUS, **changed}, "").goes_to_targets is goes


# --- what a person does ---


def test_actions_come_in_order_and_of_slid_values_the_last():
    actions = Actions()
    for action in (START, Target((0, 0, 1)), Disturb("latency_s", 0.1), Tour(True)):
        actions.put(action)
    actions.put(Target((0, 0, 2)))
    actions.put(Disturb("latency_s", 0.2))
    actions.put(Disturb("depth_noise", 2.0))
    assert actions.drain() == [
        START,
        Tour(True),
        Target((0, 0, 2)),
        Disturb("latency_s", 0.2),
        Disturb("depth_noise", 2.0),
    ]
    assert actions.drain() == []


def test_who_does_the_actions_is_woken_when_the_action_is_there():
    heard = []
    actions = Actions(lambda: heard.append(actions.drain()))
    actions.put(START)
    actions.put(STOP)
    assert heard == [[START], [STOP]]


def test_a_stop_comes_first_and_nothing_wanted_before_it_moves_the_arm():
    actions = Actions()
    said = (START, Target((0, 0, 1)), Disturb("latency_s", 0.1), SET_CURRENT, Tour(True), STOP)
    for action in said:
        actions.put(action)
    actions.put(Target((0, 0, 2)))
    assert actions.drain() == [STOP, Disturb("latency_s", 0.1), Target((0, 0, 2))]


def test_nothing_is_drawn_where_nothing_is_known():
    charts = pytest.importorskip("fvs_ros.apps.dashboard.charts")
    nan, time_s = np.nan, np.array([0.0, 0.1, 2.1, 2.2, 2.3])
    values = charts.since_gap(time_s, np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    np.testing.assert_array_equal(values, [nan, nan, 3.0, 4.0, 5.0])
    # As good as none: samples that say nothing for as long. A single one is no gap.
    time_s = np.array([0.0, 0.7, 1.4, 2.1, 2.8, 3.3])
    values = charts.since_gap(time_s, np.array([1.0, nan, nan, 4.0, nan, 6.0]))
    np.testing.assert_array_equal(values, [nan, nan, nan, 4.0, nan, 6.0])
    steady = np.arange(5.0)
    np.testing.assert_array_equal(charts.since_gap(0.1 * steady, steady), steady)
    np.testing.assert_array_equal(charts.since_gap(time_s, np.full(6, nan)), np.full(6, nan))


@pytest.mark.parametrize("text", ["0.1, 0.2, 1.5", " .1 .2 1.5 ", "0.1;0.2;1.5"])
def test_a_typed_position(text):
    assert point_of(text) == (0.1, 0.2, 1.5)


@pytest.mark.parametrize("text", ["", "1, 2", "1, 2, 3, 4", "1, 2, nan", "1, 2, -", "a b c"])
def test_what_is_no_position_is_said_to_be_none(text):
    with pytest.raises(ValueError, match="three numbers in metres"):
        point_of(text)


@pytest.mark.parametrize(
    ("host", "origin", "words"),
    [
        ("localhost:8080", None, ""),
        ("127.0.0.1:9090", "http://127.0.0.1:9090", ""),  # through a tunnel
        ("[::1]:8080", "http://[::1]:8080", ""),
        ("localhost:8080", "http://localhost:3000", "may not command this arm"),
        ("localhost:8080", "null", "may not command this arm"),
        ("evil.example:8080", "http://evil.example:8080", "not served as evil.example"),
        ("", None, "not served as"),
    ],
)
def test_only_the_page_itself_may_command(host, origin, words):
    guard = pytest.importorskip("fvs_ros.apps.dashboard.guard")
    headers = {"Host": host} if origin is None else {"Host": host, "Origin": origin}
    reason = guard.objection(headers, guard.own_names("127.0.0.1"))
    assert words in reason
    assert bool(reason) == bool(words)


@pytest.mark.parametrize(
    ("host", "words"),
    [
        ("192.168.1.7:8080", ""),
        ("[fe80::7]:8080", ""),
        ("localhost:8080", ""),
        ("{own}:8080", ""),
        ("{own}.local:8080", ""),
        ("evil.example:8080", "not served as evil.example"),  # a name that was made to point here
        ("", "not served as"),
    ],
)
def test_a_page_for_everybody_is_asked_for_by_address_or_its_own_name(host, words):
    guard = pytest.importorskip("fvs_ros.apps.dashboard.guard")
    host = host.format(own=socket.gethostname())
    reason = guard.objection(
        {"Host": host, "Origin": f"http://{host}"}, guard.own_names("0.0.0.0"), addresses=True
    )
    assert words in reason
    assert bool(reason) == bool(words)
