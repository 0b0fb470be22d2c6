"""What the page says of the loop, and who is let in, without viser."""

import socket

import numpy as np
import pytest
from cases import each

from fvs_controller_node.config import default_values
from fvs_controller_node.inbox import FEATURE
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.references import Reference, References
from fvs_dashboard import markup, picture
from fvs_dashboard.board import Action, Board, Controller
from fvs_dashboard.clicks import Clicks, shifted
from fvs_ros.camera import Intrinsics
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose

NAMES = Ball.topics.tool.name, Ball.topics.object.name


def test_what_comes_from_outside_is_no_markup():
    board, evil = Board(UR_JOINT_NAMES), "<b>x</b>"
    board.note("detector", 0.0, evil)
    values = {**ServoLoop().status_values(0.0), "state": evil, "reason": ""}
    controller = Controller({name: str(value) for name, value in values.items()}, f"{evil}; {evil}")
    board.add_status(0.0, controller)
    board.camera = "camera", np.eye(4)
    for name in ("answer", "arm"):
        board.note(name, 0.0, evil)
    for html in (
        markup.banner_html(board, Ball(), 0.0),
        markup.caption_html(evil),
        markup.line_html("reference", evil),
        markup.inputs_html(board, Ball(), 0.0),
    ):
        assert "<b>x" not in html
        assert "&lt;b&gt;x" in html


def test_what_a_camera_on_the_arm_sees_is_one_input():
    loop, board = ServoLoop(default_values(camera_mount="arm")), Board(UR_JOINT_NAMES)
    loop.supervisor.inputs.add(FEATURE, 0.0, np.ones(3))
    status = {key: str(value) for key, value in loop.status_values(0.5).items()}
    board.add_status(0.5, Controller({**status, "state": "READY"}, ""))
    html = markup.inputs_html(board, Ball(camera_mount="arm"), 0.5)
    assert "Ball</span> 500 ms ago" in html
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


def banner(kind, sentence="", target=(), truth=None, **values):
    """The banner that a controller's status gives."""
    board = Board(UR_JOINT_NAMES, kind)
    if truth is not None:
        board.note("truth", 0.0, truth)
    values |= {f"target_{name}": str(number) for name, number in target}
    board.add_status(0.0, Controller(values, sentence))
    return markup.banner_html(board, kind, 0.0)


def test_the_banner_says_way_and_angle_and_nothing_finer_than_a_tenth():
    html = banner(Pose(), error_m="0.02", way_m="0.0021", angle_rad="0.01")
    assert ">2.1 mm, 0.6°<" in html
    html = banner(Pose(), error_m="0.02", way_m="0.00004", angle_rad="0.0002")
    assert ">&lt; 0.1 mm, &lt; 0.1°<" in html
    assert "true" not in html.replace("fvs-true", "")


def test_the_banner_tells_a_simulators_true_error_from_the_estimated():
    target = [("x_m", 0.1), ("y_m", 0.0), ("z_m", 1.0)]
    html = banner(Ball(), target=target, truth=np.array([0.1, 0.003, 1.0]), error_m="0.00001")
    assert ">&lt; 0.1 mm<" in html
    assert "estimated; true 3.0 mm" in html


def test_the_banner_says_remarks_and_refusals_whole():
    sentence = "servoing, 2 mm to go; slowed, it is at an edge (no start (yet); no limits)"
    html = banner(Ball(), sentence, state="SERVOING", reason="SERVOING")
    assert ">no start (yet); no limits<" in html
    assert ">slowed, it is at an edge<" in html


def test_a_target_that_the_picture_does_not_show_is_said():
    view = picture.Picture()
    view.intrinsics = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    assert view.words(0.0, view.pixels(np.array([0.0, 0.0, 1.0]))) == ""
    view.add_image(0.0, np.zeros((48, 64, 3), np.uint8))
    for target_m, said in (([0, 0, 1], ""), ([1, 0, 1], "outside"), ([0, 0, -1], "outside")):
        words = view.words(0.0, view.pixels(np.array(target_m, float)))
        assert said in words
        assert bool(words) == bool(said)
    assert view.words(0.0, np.full((2, 2), np.nan)) == ""
    assert view.words(0.0, view.pixels(None)) == ""
    assert view.words(5.0, view.pixels(None)) == "the picture is 5 s old"
    assert "set use_sim_time" in view.words(1.8e9, view.pixels(None))


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
    board = Board(UR_JOINT_NAMES, kind)
    board.note("detector", 0.0, "right: it is lost")
    values = {"left/image_points_age_s": "0.02", "right/image_points_age_s": "0.03"}
    values |= {"target_left_u1": "1.5", "target_left_v1": "2.5", "error_m": "0.05"}
    controller = Controller({**values, "state": "READY"}, "")
    board.add_status(0.0, controller)
    html = markup.inputs_html(board, kind, 0.0)
    for words in (
        "Pattern left</span> 20 ms",
        "Pattern right</span> 30 ms",
        "right: it is lost",
    ):
        assert words in html
    assert "10.0 px" in markup.banner_html(board, kind, 0.0)
    np.testing.assert_allclose(board.error.window(0.0), [[0.0, 10.0, np.nan, np.nan]])
    np.testing.assert_array_equal(controller.target_px(kind), [[[1.5, 2.5]], [[np.nan, np.nan]]])
    assert board.feature(0.0) is None
    for camera in (0, 1):
        board.note("feature", 0.0, np.array([1.0, 2.0]) + camera, camera)
    np.testing.assert_array_equal(board.feature(0.0), [1.0, 2.0, 2.0, 3.0])
