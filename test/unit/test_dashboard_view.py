"""What the page says of the loop, and who is let in, without viser."""

import socket

import pytest
from cases import each

from fvs_controller_node.loop import ServoLoop
from fvs_dashboard import markup
from fvs_dashboard.board import Board, Controller

#: As a controller publishes it: the page reads these keys.
STATUS = {name: str(value) for name, value in ServoLoop().status_values(0.0).items()}
BALL_AGE = "ball_position_age_s"


def controller(sentence="", **changes):
    assert BALL_AGE in STATUS
    return Controller({**STATUS, BALL_AGE: "0.02", **changes}, sentence)


@pytest.fixture
def board():
    return Board(n_joints=6)


# --- banner and details ---


def test_what_comes_from_outside_is_no_markup(board):
    evil = "<b>x</b>"
    board.note("detector", 0.0, evil)
    for html in (
        markup.banner_html(controller(f"{evil}; {evil}", state=evil, reason="")),
        markup.line_html("answer", evil),
        markup.note_html(evil),
        markup.inputs_html(board, "ball_position", 0.0),
    ):
        assert "<b>x" not in html
        assert "&lt;b&gt;x" in html


def test_a_controller_that_is_silent_is_said_to_be(board):
    board.add_status(0.0, controller())
    assert "20 ms ago" in markup.inputs_html(board, "ball_position", 0.0)
    assert "ago" not in markup.inputs_html(board, "ball_position", 9.0)
    assert board.controller(9.0).sentence == "no word from the controller for 9 s"
    assert board.controller(9.0).target_m is None


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
