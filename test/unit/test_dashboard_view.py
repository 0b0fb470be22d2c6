"""What the page says of the loop, where the camera is, and what a person wants, without viser."""

import socket

import numpy as np
import pytest
from cases import each
from ur5_dh import flange_pose

from fvs_controller_node.loop import ServoLoop
from fvs_dashboard import markup
from fvs_dashboard.board import (
    RESET,
    SET_CURRENT,
    START,
    STOP,
    UNKNOWN,
    Action,
    Actions,
    Board,
    Controller,
)
from fvs_ros import topics
from fvs_sim_node.camera import CAMERAS

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


def controller(sentence="", **changed):
    return Controller({**STATUS, **changed}, sentence)


@pytest.fixture
def board():
    board = Board(n_joints=6)
    limits_s = {"ball_max_age_s": 0.2, "joint_states_max_age_s": 0.1, "jacobian_max_age_s": 0.2}
    board.parameters[topics.CONTROLLER] = limits_s
    return board


def test_every_key_that_is_read_is_one_that_the_controller_publishes():
    assert set(STATUS) <= set(ServoLoop().status_values(0.0))


# --- banner, lamps, details, scheme ---


def test_what_comes_from_outside_is_no_markup(board):
    evil = "<b>x</b>"
    board.note("detector", 0.0, evil)
    for html in (
        markup.banner_html(controller(f"{evil}; {evil}", state=evil, reason="")),
        markup.line_html("answer", evil),
        markup.notes_html([evil]),
        markup.inputs_html(board, 0.0),
    ):
        assert "<b>x" not in html
        assert "&lt;b&gt;x" in html


def test_lamps_follow_the_controllers_ages_and_else_the_pages_own(board):
    board.add_status(0.0, controller())
    lamps = markup.lamps_of(board, 0.0)
    assert [good for good, _ in lamps.values()] == [True, True, False, True]
    assert lamps["Robot program"][1] == "runs, 100 %"
    for key, value in (("robot_program_running", "false"), ("speed_scaling_percent", "0")):
        board.add_status(0.0, controller(**{key: value}))  # a robot that does not obey
        assert markup.lamps_of(board, 0.0)["Robot program"][0] is False
    board.add_ball(9.0, 10.0, np.ones(3))
    alone = markup.lamps_of(board, 9.03)
    assert alone["Ball seen"] == (None, "30 ms ago")
    assert alone["Joint states"] == (None, "unknown")
    assert alone["Robot program"][0] is None
    assert board.controller(9.03).sentence == "no word from the controller for 9 s"
    assert board.controller(9.03).target_m is None


# --- where the camera is ---


def flange_at(t_s):
    swing = 0.4 * np.sin(t_s * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))
    return flange_pose(np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0]) + swing)


def test_the_cameras_place_is_learned_and_learned_anew_when_it_was_moved(board):
    """From joint states 8 ms apart, and images exposed between two of them 36 ms earlier."""
    placement, rng = board.placement, np.random.default_rng(1)
    assert placement.note == UNKNOWN
    for camera, from_s in ((CAMERAS["front"], 0.0), (CAMERAS["overhead"], 20.0)):
        for step in range(2500):
            now_s = from_s + 0.008 * step
            board.add_joints(now_s, now_s, np.full(6, now_s), np.zeros(6))
            if step % 4 == 0:
                flange = flange_at(now_s - 0.036)
                ball_m = flange[:3, 3] + 0.09 * flange[:3, 2] + 1e-3 * rng.normal(size=3)
                seen_m = camera.rotation.T @ (ball_m - camera.position_m)
                if step % 200 == 0:
                    seen_m = np.array([0.5, 0.5, 3.0])  # a wrong detection
                board.add_ball(now_s, now_s - 0.036, seen_m)
                board.learn_camera(lambda joints: flange_at(joints[0]))
        np.testing.assert_allclose(placement.pose[:3, 3], camera.position_m, atol=0.005)
        np.testing.assert_allclose(placement.pose[:3, :3], camera.rotation, atol=0.005)
        assert "learned" in placement.note


# --- what a person does ---


NEAR, FAR, TOUR = Action("target", (0, 0, 1)), Action("target", (0, 0, 2)), Action("tour", True)
SMALL, LARGE = Action("fvs_sim_node/depth_noise", 1.0), Action("fvs_sim_node/depth_noise", 2.0)


@each(
    ("said", "done"),
    [
        ((START, NEAR, SMALL, TOUR, FAR, LARGE), [START, TOUR, FAR, LARGE]),
        ((START, NEAR, LARGE, SET_CURRENT, TOUR, STOP, FAR), [STOP, LARGE, FAR]),
        ((START, NEAR, LARGE, SET_CURRENT, TOUR, RESET, FAR), [RESET, LARGE, FAR]),
    ],
)
def test_a_stop_comes_first_and_nothing_wanted_before_it_moves_the_arm(said, done):
    woken = []
    actions = Actions(lambda: woken.append(True))
    for one in said:
        actions.put(one)
    assert len(woken) == len(said)
    assert actions.drain() == done


# --- who is let in ---


@each(
    ("served_at", "host", "origin", "words"),
    [
        ("127.0.0.1", "127.0.0.1:9090", "http://127.0.0.1:9090", ""),  # through a tunnel
        ("127.0.0.1", "localhost:8080", "http://localhost:3000", "may not command this arm"),
        ("127.0.0.1", "localhost:8080", "null", "may not command this arm"),
        ("127.0.0.1", "evil.example:8080", "http://evil.example:8080", "not served as evil.ex"),
        ("0.0.0.0", "192.168.1.7:8080", "http://192.168.1.7:8080", ""),
        ("0.0.0.0", "{own}.local:8080", "http://{own}.local:8080", ""),
    ],
)
def test_only_the_page_itself_may_command_and_under_its_own_name(served_at, host, origin, words):
    guard = pytest.importorskip("fvs_dashboard.guard")
    own = socket.gethostname()
    headers = {"Host": host.format(own=own), "Origin": origin.format(own=own)}
    reason = guard.objection(headers, served_at)
    assert words in reason
    assert bool(reason) == bool(words)
