"""The page as it is served, without ROS: who is let in, and what stands where."""

import time
import types
import urllib.request

import numpy as np
import pytest
from cases import each

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

import websockets
from page_client import PageClient
from viser.infra import _infra

from fvs_dashboard import config, guard
from fvs_dashboard.board import Board, Controller
from fvs_dashboard.page import Page
from fvs_dashboard.picture import Picture
from fvs_dashboard.scene import Arm
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.robot import ROBOTS, robot_description


def served(port=0):
    values = config.DashboardConfig(port=port, model_path="any")
    return Page(values, lambda action: None)


@pytest.fixture
def page():
    page = served()
    yield page
    page.close()


# --- who is let in ---


def test_a_page_whose_guard_did_not_take_is_not_served(monkeypatch):
    # A later viser that keeps websockets' own server, where the guard does not reach it.
    server = types.SimpleNamespace(**vars(websockets.asyncio.server))
    own = {**vars(websockets), "asyncio": types.SimpleNamespace(server=server)}
    monkeypatch.setattr(_infra, "websockets", types.SimpleNamespace(**own))
    tried = []
    check = guard.turns_others_away
    monkeypatch.setattr(
        "fvs_dashboard.page.turns_others_away",
        lambda host, port: tried.append((host, port)) or check(host, port),
    )
    with pytest.raises(ValueError, match="would let any web site command the arm") as refused:
        served()
    assert config.VISER in str(refused.value)
    ((host, port),) = tried
    with pytest.raises(OSError, match="refused"):
        PageClient(f"http://{host}:{port}")


def test_no_other_page_may_hold_this_one_in_a_frame(page):
    with urllib.request.urlopen(page.address, timeout=10.0) as answer:
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert answer.headers["X-Frame-Options"] == "DENY"


def test_a_request_for_a_public_tunnel_is_refused(page, monkeypatch):
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *_: pytest.fail("a tunnel"))
    assert page._server.request_share_url() is None


# --- a camera on the arm ---


def soon(condition):
    end_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def test_a_camera_on_the_arm_is_dragged_to_where_it_shall_see_the_object():
    # The camera is level at (2, 0, 0.4) and looks along -x, as long as its pose is not known.
    kind, actions = Pose(), []
    values = config.DashboardConfig(port=0, feature="pose", camera_mount="arm")
    page = Page(values, actions.append)
    client = PageClient(page.address)

    def drawn(name, position_m):
        return np.allclose(client.positions.get(name, np.inf), position_m)

    try:
        board, facing = Board(UR_JOINT_NAMES), np.diag([1.0, -1.0, -1.0])
        seen = kind.of_body(np.array([0.1, 0.0, 0.5]), facing)
        for name in ("feature", "object"):
            board.note(name, 0.0, seen)
        target = {"target_x_m": 0.0, "target_y_m": 0.2, "target_z_m": 0.3}
        target |= {"target_qw": 0.0, "target_qx": 1.0, "target_qy": 0.0, "target_qz": 0.0}
        status = {name: str(number) for name, number in target.items()}
        board.add_status(0.0, Controller(status, ""))
        page.update(board, [Picture()], 0.0)
        soon(lambda: drawn("/object", [1.5, 0.1, 0.4]))
        # It goes on by 0.2 m, 0.1 m to its right, which is y, and 0.2 m up.
        soon(lambda: drawn("/target", [1.8, 0.1, 0.6]))
        client.drag("/target", (1.5, 0.1, 0.1))  # upright, below the object
        soon(lambda: actions)
        assert actions[0].name == "target"
        position_m, wxyz = np.split(np.array(actions[0].value), [3])
        np.testing.assert_allclose(position_m, [0.0, 0.0, 0.3], atol=1e-9)
        np.testing.assert_allclose(np.abs(wxyz), 0.5, atol=1e-9)  # as the object is in the room
        client.set("x, y, z (m)", (0.1, 0.2, 0.3))
        client.set("turned about x, y, z (°)", (0.0, 0.0, 90.0))
        soon(lambda: page._panel._fields[1].value == (0.0, 0.0, 90.0))
        actions.clear()
        client.press("Go")
        soon(lambda: actions)
        np.testing.assert_allclose(actions[0].value, [0.1, 0.2, 0.3, 0.5**0.5, 0.0, 0.0, 0.5**0.5])
    finally:
        client.close()
        page.close()


# --- cameras of which nothing is known ---


def test_a_click_in_a_picture_is_a_target_there_and_of_another_size_too():
    actions = []
    values = config.DashboardConfig(
        port=0, feature="points", points=Points(cameras=("left", "right"))
    )
    page = Page(values, actions.append)
    client = PageClient(page.address)
    try:
        pictures = [Picture(), Picture()]

        def click(camera, x, z):
            position = np.array(client.positions[f"/picture/{camera}"]) + [x, -2.0, z]
            client.click(f"/picture/{camera}", position - [0.5, 0.0, 0.0], (0.25, 1.0, 0.0))

        click(0, 0.0, 0.0)  # no picture, so it means nothing
        pictures[0].add_image(0.0, np.zeros((480, 640, 3), np.uint8))
        pictures[1].add_image(0.0, np.zeros((1080, 1920, 3), np.uint8))
        page.update(Board(UR_JOINT_NAMES, values.kind), pictures, 0.0)
        soon(lambda: np.isclose(client.positions["/picture/1"][2], -0.79 - 0.5 * 0.5625))
        click(0, 0.25, 0.125)
        soon(lambda: "where it shall be in right" in page._panel.clicks.words)
        click(1, 0.0, 0.0)
        soon(lambda: actions)
        assert actions[0].name == "target"
        np.testing.assert_allclose(actions[0].value, [479.5, 159.5, 959.5, 539.5], atol=1e-6)
        client.set("A click", "track this")
        soon(lambda: page._panel._click.value == "track this")
        click(0, 0.0, 0.0)
        click(1, 0.5, 0.28125)
        soon(lambda: actions[1:])
        assert actions[1].name == "fvs_detector_node/track_px"
        np.testing.assert_allclose(actions[1].value, [319.5, 239.5, 1919.0, 0.0], atol=1e-6)
    finally:
        client.close()
        page.close()


# --- the robot's model, as a driver publishes it ---


UR5 = ROBOTS["ur5"]
ON_A_TABLE = (
    '<link name="world"/><joint name="stands" type="fixed"><parent link="world"/>'
    '<child link="base_link"/><origin xyz="0.5 0 0.8" rpy="0 0 0"/></joint></robot>'
)


@each(
    ("text", "prefix", "base_m"),
    [
        (robot_description(UR5), "", [0.0, 0.0, 0.0]),
        (robot_description(UR5, "left_"), "left_", [0.0, 0.0, 0.0]),
        (robot_description(UR5).replace("</robot>", ON_A_TABLE), "", [0.5, 0.0, 0.8]),
    ],
)
def test_the_camera_stands_in_the_link_that_its_pose_names(text, prefix, base_m):
    arm = Arm(text, [prefix + name for name in UR_JOINT_NAMES])
    pose = arm.in_root(f"{prefix}base_link", np.eye(4))
    np.testing.assert_allclose(pose[:3, 3], base_m, atol=1e-12)
    assert arm.missing == ""


def test_a_mesh_that_is_not_here_is_a_cube():
    mesh = '<visual><geometry><mesh filename="package://a/b.stl"/></geometry></visual></link>'
    arm = Arm(robot_description(UR5).replace("</link>", mesh, 1), UR_JOINT_NAMES)
    assert "1 meshes that are not here, such as package://a/b.stl" in arm.missing
