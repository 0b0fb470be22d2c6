"""What the page says of the loop, and who is let in, without viser."""

import socket

import numpy as np
import pytest
from cases import each

from fvs_controller_node.config import default_values
from fvs_controller_node.inbox import FEATURE
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.references import Reference, References
from fvs_dashboard import markup
from fvs_dashboard.board import Action, Board, Controller
from fvs_dashboard.clicks import Clicks, shifted
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose

NAMES = Ball.topics.tool.name, Ball.topics.object.name


def test_what_comes_from_outside_is_no_markup():
    board, evil = Board(n_joints=6), "<b>x</b>"
    board.note("detector", 0.0, evil)
    values = {**ServoLoop().status_values(0.0), "state": evil, "reason": ""}
    controller = Controller({name: str(value) for name, value in values.items()}, f"{evil}; {evil}")
    for html in (
        markup.banner_html(controller, Ball()),
        markup.line_html("answer", evil),
        markup.note_html(evil),
        markup.inputs_html(board, Ball(), 0.0),
    ):
        assert "<b>x" not in html
        assert "&lt;b&gt;x" in html


def test_what_a_camera_on_the_arm_sees_is_one_input():
    loop, board = ServoLoop(default_values(camera_mount="arm")), Board(6)
    loop.supervisor.inputs.add(FEATURE, 0.0, np.ones(3))
    status = {key: str(value) for key, value in loop.status_values(0.5).items()}
    board.add_status(0.5, Controller({**status, "state": "READY"}, ""))
    html = markup.inputs_html(board, Ball(camera_mount="arm"), 0.5)
    assert "Seen</span> 500 ms ago" in html
    assert "Object" not in html


def test_references_are_listed_whatever_stands_in_their_file(tmp_path):
    path = tmp_path / "references.yaml"
    kind = Pose()
    turned = kind.of_body(np.array([0.1, 0.0, 0.05]), np.diag([-1.0, -1.0, 1.0]))
    References(path, kind, NAMES).keep("grasp", Reference(turned, "object", 0.5))
    References(path, Ball(), NAMES).keep("<b>", Reference(np.zeros(3), "camera"))
    known = References(path, kind, NAMES).entries()
    labels = markup.reference_labels(known)
    assert labels == {"grasp: object, 50 %": "grasp", "<b>: cannot be used": "<b>"}
    text = markup.reference_text(known["grasp"], kind)
    assert text == (
        "in the object's frame: (100.0 mm, 0.0 mm, 50.0 mm), turned by (0.0, 0.0, 180.0) degrees"
    )
    assert "feature ball, expected pose" in markup.reference_text(known["<b>"], kind)


def test_the_banner_says_way_and_angle_of_a_pose():
    status = Controller({"error_m": "0.02", "way_m": "0.0021", "angle_rad": "0.01"}, "")
    assert "2.10 mm, 0.57°" in markup.banner_html(status, Pose())
    servoing = {"state": "SERVOING", "reason": "SERVOING"}
    sentence = "servoing, 2 mm to go; slowed, it is at an edge (no start (yet); no limits)"
    html = markup.banner_html(Controller(servoing, sentence), Ball())
    assert 'title="no start (yet); no limits. slowed, it is at an edge"' in html


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


# --- image points ---


def test_clicks_in_all_pictures_make_a_target_and_on_all_points_a_detectors_setting():
    clicks = Clicks(Points(2, cameras=("left", "right")))
    assert clicks.take(1, [5.0, 6.0], track=False) is None
    assert clicks.words == "now click where it shall be in left"
    assert clicks.take(1, [7.0, 8.0], track=False) is None  # the last counts
    assert clicks.take(0, [1.0, 2.0], track=False) == Action("target", (1.0, 2.0, 7.0, 8.0))
    assert clicks.take(0, [1.0, 2.0], track=True) is None
    assert clicks.words == "now click on point 2 in left"
    for px in ([3.0, 4.0], [5.0, 6.0]):
        assert clicks.take(int(px[0] == 5.0), px, track=True) is None
    assert clicks.words == "now click on point 2 in right"
    action = clicks.take(1, [7.0, 8.0], track=True)
    assert action == Action("fvs_detector_node/track_px", tuple(map(float, range(1, 9))))
    assert clicks.words == ""
    assert clicks.take(1, [9.0, 9.0], track=True) is None
    action = clicks.take(1, [10.0, 9.0], track=True)
    assert action.value == (1.0, 2.0, 3.0, 4.0, 9.0, 9.0, 10.0, 9.0)
    assert Clicks(Points()).take(0, [1.0, 2.0], track=False) == Action("target", (1.0, 2.0))


def test_a_target_of_the_first_point_takes_the_others_with_it():
    kind, z = Points(2, cameras=("left", "right")), np.arange(8.0)
    target = shifted(z, np.array([10.0, 20.0, 30.0, 40.0]), kind)
    np.testing.assert_array_equal(target, [10.0, 20.0, 12.0, 22.0, 30.0, 40.0, 32.0, 42.0])
    assert shifted(None, np.zeros(4), kind) is None
    np.testing.assert_array_equal(shifted(None, np.ones(2), Points()), [1.0, 1.0])


def test_what_is_said_of_image_points_is_in_pixels_and_of_each_camera():
    kind = Points(cameras=("left", "right"))
    board = Board(6, kind)
    board.note("detector", 0.0, "right: it is lost")
    values = {"left/image_points_age_s": "0.02", "right/image_points_age_s": "0.03"}
    values |= {"target_left_u1": "1.5", "target_left_v1": "2.5", "error_m": "0.05"}
    controller = Controller({**values, "state": "READY"}, "")
    board.add_status(0.0, controller)
    html = markup.inputs_html(board, kind, 0.0)
    for words in (
        "Seen left</span> 20 ms",
        "Seen right</span> 30 ms",
        "right: it is lost",
    ):
        assert words in html
    assert "10.0 px" in markup.banner_html(controller, kind)
    np.testing.assert_allclose(board.error.window(0.0), [[0.0, 10.0]])
    np.testing.assert_array_equal(controller.target_px(kind), [[[1.5, 2.5]], [[np.nan, np.nan]]])
    assert board.feature(0.0) is None
    for camera in (0, 1):
        board.note("feature", 0.0, np.array([1.0, 2.0]) + camera, camera)
    np.testing.assert_array_equal(board.feature(0.0), [1.0, 2.0, 2.0, 3.0])
