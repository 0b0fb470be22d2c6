"""The page beside a real controller: it shows, it drives, and it does no harm."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

from harness import PlayedRobot
from page_client import PageClient
from websockets.exceptions import InvalidStatus

from fvs_dashboard.tour import LOST
from fvs_ros import ros, topics
from fvs_ros.camera import Intrinsics
from fvs_ros.joints import HOME_JOINTS_RAD, UR_JOINT_NAMES
from fvs_sim_node.rendering import camera_preset
from fvs_sim_node.ur5_urdf import urdf_text

DASHBOARD = "fvs_dashboard.dashboard_node"
CONTROLLER = "fvs_controller_node.node"
#: The page is tested, not the machine.
PATIENT = {f"{name}_max_age_s": 1.0 for name in ("joint_states", "ball", "jacobian")}
TARGET = "x, y, z (m)"
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


def address_of(harness, process):
    """Where the page is, once it is served."""

    def found():
        return re.search(r"^page: (http://\S+)$", harness.output(process), re.M)

    harness.spin_until(lambda: found() is not None or process.poll() is not None, 30.0, "the page")
    assert found(), harness.output(process)
    return found().group(1)


@pytest.fixture
def pages():
    """Opens pages; all are closed at the end."""
    opened = []

    def open_page(address):
        opened.append(PageClient(address))
        return opened[-1]

    yield open_page
    for page in opened:
        page.close()


@pytest.fixture
def loop(ros_module, ros_beside, pages):
    """A played robot, a controller that is stopped, and a page that somebody looks at."""
    robot = PlayedRobot(ros_beside)
    controller = ros_module.keep(CONTROLLER, **PATIENT)
    process = ros_module.keep(DASHBOARD, port=0)
    page = pages(address_of(ros_beside, process))
    robot.meet_controller()
    ros_beside.spin_until(lambda: states(page) in ("WAITING", "READY"), 20.0, "all inputs")
    return ros_beside, robot, controller, process, page


def states(page):
    found = re.search(r'data-state="(\w+)"', page.text())
    return found.group(1) if found else ""


def wait_for_state(harness, page, state):
    harness.spin_until(lambda: states(page) == state, 15.0, f"{state} on the page", page.text)


def set_target(harness, page, position):
    page.set(TARGET, ", ".join(f"{value:.3f}" for value in position))
    page.press("Go")


def start(harness, page):
    """Have the arm servo where it stands; again if the machine made an input late just then."""
    for button, state in (("Set current as target", "READY"), ("Start", "SERVOING")):
        for _ in range(3):
            page.press(button)
            with contextlib.suppress(AssertionError):
                harness.spin_until(lambda state=state: states(page) == state, 5.0)
                break
    assert states(page) == "SERVOING", page.text()


def test_the_page_is_served_and_says_where(ros_test):
    process = ros_test.start_node(DASHBOARD, port=0)
    address = address_of(ros_test, process)
    with urllib.request.urlopen(address, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()
    output = ros_test.output(process)
    assert output.strip() == f"page: {address}"  # nothing else is said at a start
    began_s = time.monotonic()
    assert ros_test.stop(process) == 0
    assert time.monotonic() - began_s < 3.0


def test_a_browser_that_looks_does_not_hold_the_end(loop):
    harness, _, _, process, _ = loop
    began_s = time.monotonic()
    assert harness.stop(process, signal.SIGINT) == 0
    assert time.monotonic() - began_s < 4.0
    assert "Traceback" not in harness.output(process)


def test_a_host_that_is_not_here_is_said_in_one_sentence(ros_test):
    process = ros_test.start_node(DASHBOARD, port=0, host="203.0.113.1")
    assert ros_test.wait(process) == 2
    assert "cannot start: the page cannot be served at 203.0.113.1" in ros_test.output(process)


def test_the_arm_goes_where_the_page_says_and_stops_at_a_press(loop):
    harness, robot, _, _, page = loop
    start(harness, page)
    target = robot.ball + np.array([0.1, -0.05, 0.05])
    set_target(harness, page, target)
    harness.spin_until(robot.moving, what="the arm to move")
    harness.spin_until(
        lambda: np.linalg.norm(robot.ball - np.round(target, 3)) < 0.005, what="the ball there"
    )
    assert "Joint states" in page.text()
    set_target(harness, page, robot.ball - np.array([0.1, 0.0, 0.0]))
    harness.spin_until(robot.moving, what="the arm to move again")
    page.press("Stop")
    harness.spin_until(robot.standing, what="zeros")
    assert list(robot.commands[-1][1].data) == [0.0] * 6
    wait_for_state(harness, page, "READY")


def test_numbers_that_are_typed_wait_for_their_button(loop):
    harness, robot, _, _, page = loop
    targets = harness.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)
    page.press("Set current as target")
    wait_for_state(harness, page, "READY")
    typed = tuple(round(float(value) + 0.05, 3) for value in robot.ball)
    text = " ".join(str(value) for value in typed)
    page.set(TARGET, text)
    harness.spin_for(4.5)  # longer than what needs no button is left alone
    assert page.value(TARGET) == text
    for count in (1, 2):  # twice, before the controller may have told the new target
        page.press("Go")
        harness.spin_until(lambda count=count: len(targets) == count, what="a target")
        point = targets[-1].point
        assert (point.x, point.y, point.z) == typed
    page.set(TARGET, "0.1, 0.2")
    page.press("Go")
    harness.spin_until(lambda: "three numbers in metres" in page.text(), what="a refusal")
    assert len(targets) == 2
    page.press("Set current as target")  # and what was typed is forgotten, with the refusal
    harness.spin_until(lambda: page.value(TARGET).count(",") == 2, what="the target as it is")
    assert "three numbers in metres" not in page.text()


def test_a_dragged_target_is_followed_and_dropped(loop):
    harness, robot, _, _, page = loop
    start(harness, page)
    wanted = tuple(float(value) for value in robot.ball + [0.06, 0.0, 0.0])
    halfway = tuple(float(value) for value in robot.ball + [0.03, 0.0, 0.0])
    page.drag_target(halfway, wanted)
    harness.spin_until(lambda: np.linalg.norm(robot.ball - wanted) < 0.005, what="the ball there")


def test_what_the_controller_refuses_stands_on_the_page(loop):
    harness, _, _, _, page = loop
    set_target(harness, page, (0.0, 0.0, 9.0))

    def stands(name, words):
        return re.search(f'id="fvs-{name}"[^>]*>[^<]*{words}', page.text()) is not None

    harness.spin_until(lambda: stands("refusal", "refused: z"), 10.0, "the refusal", page.text)
    assert not stands("sentence", "refused")  # is said once, near the target
    page.press("Start")
    harness.spin_until(lambda: stands("answer", "start: "), 10.0, "an answer", page.text)


def test_another_law_is_chosen_once_the_arm_is_stopped(loop):
    harness, _, _, _, page = loop
    start(harness, page)
    harness.spin_until(lambda: page.value("Law") == "ftsm", what="the law that runs")
    page.set("Law", "proportional")
    words = "the law changes only while the arm is stopped; press Stop first"
    harness.spin_until(lambda: words in page.text(), 10.0, "the refusal", page.text)
    harness.spin_until(lambda: page.value("Law") == "ftsm", what="the law that still runs")
    page.press("Stop")
    wait_for_state(harness, page, "READY")
    page.set("Law", "proportional")
    wanted = GetParameters.Request(names=["law"])

    def law():
        answer = harness.call(GetParameters, "fvs_controller_node/get_parameters", wanted)
        return answer.values[0].string_value

    harness.spin_until(lambda: law() == "proportional", what="the other law")
    harness.spin_until(
        lambda: "Scheme: proportional" in page.labels(), what="its name", story=page.labels
    )


def test_a_controller_that_is_gone_shows_as_that_and_comes_back(ros_module, loop):
    harness, _, controller, process, page = loop
    harness.stop(controller)
    wait_for_state(harness, page, "SILENT")
    harness.spin_until(lambda: "no word from the controller" in page.text())
    targets = harness.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)
    refusal = "not done: the controller is silent"
    before = harness.output(process).count(refusal)
    for count, wish in enumerate(
        (lambda: page.press("Start"), lambda: page.drag_target((0.0, 0.1, 1.4)))
    ):
        wish()
        harness.spin_until(
            lambda count=count: harness.output(process).count(refusal) > before + count
        )
    harness.spin_until(lambda: refusal in page.text(), what="it on the page")
    assert not targets
    ros_module.keep(CONTROLLER, **PATIENT)
    wait_for_state(harness, page, "WAITING")


def test_the_page_s_own_browser_is_let_in_and_another_site_s_is_not(loop):
    harness, _, _, process, _ = loop
    address = address_of(harness, process)
    PageClient(address, Origin=address).close()
    for origin in ("http://evil.example", "null"):
        with pytest.raises(InvalidStatus) as refused:
            PageClient(address, Origin=origin)
        assert refused.value.response.status_code == 403


def test_parameters_without_ros_args_are_refused_not_passed_over(ros_test):
    process = ros_test.start(DASHBOARD, "-p", "port:=9000")
    assert ros_test.wait(process) == 2
    assert "unknown argument '-p'" in ros_test.output(process)
    assert "--ros-args -p name:=value" in ros_test.output(process)


@pytest.mark.parametrize("odd", [["-p", "foo"], ["--params-file", "/none.yaml"]])
def test_what_ros_cannot_read_is_said_in_a_sentence(ros_test, odd):
    process = ros_test.start(DASHBOARD, "--ros-args", *odd)
    assert ros_test.wait(process) == 2
    assert "cannot start:" in ros_test.output(process)
    assert "Traceback" not in ros_test.output(process)


def test_a_target_is_for_the_controller_that_was_there(ros_module, loop):
    """One that is started later stands until somebody wants it somewhere."""
    harness, _, controller, _, page = loop
    set_target(harness, page, (0.0, 0.1, 1.4))
    wait_for_state(harness, page, "READY")
    harness.stop(controller)
    harness.spin_for(1.0)
    statuses = harness.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    ros_module.keep(CONTROLLER, **PATIENT)
    harness.spin_until(
        lambda: statuses and ros.from_status(statuses[-1])["reason"] == "NO_TARGET",
        20.0,
        "all inputs but a target",
    )
    harness.spin_for(1.0)
    assert ros.from_status(statuses[-1])["reason"] == "NO_TARGET"


def test_a_stop_is_heard_while_others_want_the_processor(loop):
    harness, robot, _, _, page = loop
    start(harness, page)
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        harness.spin_for(2.0)
        set_target(harness, page, robot.ball + np.array([0.15, -0.05, 0.05]))
        harness.spin_until(robot.moving, what="the arm to move")
        page.press("Stop")
        harness.spin_until(robot.standing, 1.5, "zeros")
    finally:
        for process in busy:
            process.kill()
            process.wait()


def test_a_stop_is_repeated_until_it_is_answered(loop):
    harness, _, controller, process, page = loop
    start(harness, page)
    controller.send_signal(signal.SIGSTOP)
    page.press("Stop")
    page.press("Set current as target")  # means no other stop
    harness.spin_until(lambda: "does not answer yet" in page.text(), what="words")
    controller.send_signal(signal.SIGCONT)
    wait_for_state(harness, page, "READY")
    harness.spin_until(lambda: "stop: stopping" in harness.output(process), what="the answer")


def test_the_arm_and_the_camera_are_drawn_from_the_topics(loop):
    harness, _, _, process, page = loop
    latched = harness.node.create_publisher(String, topics.ROBOT_DESCRIPTION.name, ros.QOS_LATCHED)
    latched.publish(String(data=urdf_text()))
    harness.spin_until(lambda: any("wrist_3_link" in name for name in page.nodes), 15.0, "an arm")
    harness.spin_until(lambda: "place is not known yet" in page.text())
    page.nodes.clear()
    latched.publish(String(data=urdf_text().replace("0.085", "0.095")))  # another robot
    harness.spin_until(lambda: any("wrist_3_link" in name for name in page.nodes), 15.0, "another")
    assert "Warning" not in harness.output(process)
    pose = camera_preset("front").in_base_link()
    poses = harness.node.create_publisher(
        PoseStamped, topics.TRUE_CAMERA_POSE.name, ros.QOS_LATCHED
    )
    poses.publish(ros.to_pose(1.0, "base_link", pose.position_m, np.zeros(4)))  # no rotation
    harness.spin_until(lambda: "true_camera_pose" in harness.output(process), what="a warning")
    poses.publish(ros.to_pose(1.0, "base_link", pose.position_m, pose.quaternion_xyzw))
    harness.spin_until(lambda: "/base/camera" in page.nodes, what="the camera")
    np.testing.assert_allclose(page.nodes["/base/camera"], pose.position_m, atol=1e-6)
    harness.spin_until(lambda: "place is not known yet" not in page.text())


def test_an_arm_without_its_meshes_is_seen_and_told_of(loop):
    harness, _, _, process, page = loop
    mesh = '<geometry><mesh filename="package://no_such_package/part.dae"/></geometry>'
    text = re.sub("<geometry>.*?</geometry>", mesh, urdf_text(), flags=re.DOTALL)
    latched = harness.node.create_publisher(String, topics.ROBOT_DESCRIPTION.name, ros.QOS_LATCHED)
    latched.publish(String(data=text))
    harness.spin_until(lambda: "/robot/visual/missing" in page.drawn, 15.0, "words in the view")
    bars = [name for name in page.drawn if name.endswith("_bar")]
    assert len(bars) == 5
    assert all(len(page.drawn[name]["glb_data"]) > 1000 for name in bars)
    words = "install ros-jazzy-no-such-package"
    assert words in page.drawn["/robot/visual/missing"]["text"].replace("\n", " ")
    harness.spin_until(lambda: words in harness.output(process), what="a warning")
    harness.spin_for(0.3)
    assert harness.output(process).count(words) == 1


def test_images_are_asked_for_only_while_somebody_looks(loop, pages):
    harness, _, _, process, page = loop
    images = harness.node.create_publisher(Image, topics.COLOR_IMAGE.name, ros.QOS_RELIABLE)
    infos = harness.node.create_publisher(CameraInfo, topics.CAMERA_INFO.name, ros.QOS_RELIABLE)
    harness.spin_until(lambda: images.get_subscription_count() == 1, what="a subscription")
    red = np.full((480, 640, 3), (200, 30, 20), np.uint8)
    before = page.counts["GuiUpdateMessage"]

    def picture():
        infos.publish(ros.to_camera_info(1.0, "camera", CAMERA))
        images.publish(ros.to_image(1.0, "camera", red, "rgb8"))
        element = next(e for e in page.elements.values() if "_format" in e and "uuid" not in e)
        return page.counts["GuiUpdateMessage"] > before and element["_data"] is not None

    harness.spin_until(picture, what="a picture")
    page.close()
    harness.spin_until(lambda: images.get_subscription_count() == 0, what="no subscription")
    again = pages(address_of(harness, process))
    harness.spin_until(lambda: images.get_subscription_count() == 1, what="a subscription again")
    assert again.labels()


def test_a_detectors_sentence_stands_on_the_page(loop):
    harness, _, _, _, page = loop
    statuses = harness.publisher(DiagnosticStatus, topics.DETECTOR_STATUS.name)
    sentence = "no ball of that colour is in the image"

    def told():
        statuses.publish(ros.to_status(ros.WARN, "fvs_detector_node", sentence, {}))
        return sentence in page.text()

    harness.spin_until(told, 10.0, "the detector's sentence", page.text)
    harness.spin_until(lambda: sentence not in page.text(), 10.0, "it to be forgotten")


def test_the_tour_goes_on_until_a_person_takes_over(ros_test, pages):
    PlayedRobot(ros_test)
    targets = ros_test.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)
    ros_test.start_node(CONTROLLER, autostart=True, **PATIENT)
    given = {"tour": True, "tour_period_s": 1.0, "model_path": "models/ur5_front.npz"}
    # A page that draws once a second is not taken for a late one.
    process = ros_test.start_node(DASHBOARD, port=0, rate_hz=1.0, **given)
    page = pages(address_of(ros_test, process))
    ros_test.spin_until(lambda: len(targets) > 2, 30.0, "three targets of the tour")
    wait_for_state(ros_test, page, "SERVOING")
    ros_test.spin_until(lambda: page.value("Tour"), what="the tour's tick on the page")
    page.press("Set current as target")
    ros_test.spin_until(lambda: not page.value("Tour"), what="the end of the tour")
    count = len(targets)
    ros_test.spin_for(1.5)
    assert len(targets) == count


def test_the_simulator_is_disturbed_and_reset_from_the_page(ros_test, pages):
    simulator = ros_test.start_node("fvs_sim_node.node")
    process = ros_test.start_node(DASHBOARD, port=0, image=False)
    page = pages(address_of(ros_test, process))

    def visible(label):
        return page.elements[page.find(label)].get("visible") is True

    ros_test.spin_until(lambda: visible("Bump the camera"), 20.0, "the simulator")
    ros_test.spin_until(lambda: "/base/camera" in page.nodes, what="the camera")
    page.press("Bump the camera")
    page.set("Depth noise (×)", 2.5)

    wanted = GetParameters.Request(names=["depth_noise", "camera_rotation_deg"])

    def told():
        noise, turns = ros_test.call(GetParameters, "fvs_sim_node/get_parameters", wanted).values
        return noise.double_value, any(turns.double_array_value)

    ros_test.spin_until(lambda: told() == (2.5, True), what="the disturbances")
    page.set("Depth noise (×)", 50.0)
    ros_test.spin_until(
        lambda: "refused: parameter depth_noise must be" in page.text(), what="the refusal"
    )
    page.press("Reset everything")
    ros_test.spin_until(lambda: told() == (1.0, False), what="the simulator as it began")
    simulator.send_signal(signal.SIGSTOP)
    try:
        page.press("Reset everything")
        ros_test.spin_until(lambda: "fvs_sim_node/reset does not answer" in page.text(), what="it")
    finally:
        simulator.send_signal(signal.SIGCONT)


def test_a_tour_that_loses_the_ball_puts_the_simulated_arm_back_and_goes_on(ros_test, pages):
    ros_test.start_node("fvs_sim_node.node")
    ros_test.start_node("fvs_estimator_node.node", model_path="models/ur5_front.npz")
    ros_test.start_node(CONTROLLER, autostart=True)
    process = ros_test.start_node(
        DASHBOARD, port=0, image=False, tour=True, model_path="models/ur5_front.npz"
    )
    page = pages(address_of(ros_test, process))
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    home = np.array(HOME_JOINTS_RAD)

    def away_rad():
        joints = dict(zip(states[-1].name, states[-1].position, strict=True))
        return np.abs([joints[name] for name in UR_JOINT_NAMES] - home).max()

    ros_test.spin_until(lambda: states and away_rad() > 0.2, 30.0, "the tour to begin")
    ros_test.set_parameters("fvs_sim_node", camera_covered=True)
    wait_for_state(ros_test, page, "HOLDING")
    ros_test.spin_until(lambda: away_rad() < 1e-3, 20.0, "the arm where it began", page.text)
    ros_test.spin_until(lambda: LOST in page.text(), 5.0, "why", page.text)
    ros_test.set_parameters("fvs_sim_node", camera_covered=False)
    ros_test.spin_until(lambda: away_rad() > 0.2, 20.0, "the tour to go on", page.text)
    assert page.value("Tour")
    page.press("Stop")
    wait_for_state(ros_test, page, "READY")
    ros_test.spin_until(lambda: not page.value("Tour"), what="the end of the tour")
    page.press("Reset everything")
    ros_test.spin_until(lambda: away_rad() < 1e-3, 5.0, "the arm where it began", page.text)
    ros_test.spin_until(lambda: "everything reset; target set to" in page.text(), 10.0, "the end")
    wait_for_state(ros_test, page, "READY")
