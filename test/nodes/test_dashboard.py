"""The page beside a real controller: it shows, it drives, and it does no harm."""

from __future__ import annotations

import contextlib
import re
import signal
import time
import urllib.request

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import CameraInfo, Image, JointState

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

from harness import PlayedRobot
from page_client import PageClient

from fvs_ros import ros, topics
from fvs_ros.camera import Intrinsics
from fvs_ros.joints import HOME_JOINTS_RAD, UR_JOINT_NAMES

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
    """A played robot, a controller that is stopped, and a page that a browser shows."""
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
    page.set(TARGET, tuple(float(value) for value in position))
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
    assert ros_test.output(process).strip() == f"page: {address}"  # nothing else at a start
    began_s = time.monotonic()
    assert ros_test.stop(process) == 0
    assert time.monotonic() - began_s < 3.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "port:=9000"], "unknown argument '-p'"),
        (["--ros-args", "--params-file", "/none.yaml"], "cannot start:"),
        (["--ros-args", "-p", "host:=203.0.113.1"], "the page cannot be served at 203.0.113.1"),
    ],
)
def test_what_cannot_be_served_is_refused_in_a_sentence(ros_test, arguments, words):
    process = ros_test.start(DASHBOARD, *arguments)
    assert ros_test.wait(process) == 2
    assert words in ros_test.output(process)
    assert "Traceback" not in ros_test.output(process)


def test_the_arm_goes_where_the_page_says_and_stops_at_a_press(loop):
    harness, robot, _, process, page = loop
    targets = harness.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)
    start(harness, page)
    target = np.round(robot.ball + [0.1, -0.05, 0.05], 3)
    page.set(TARGET, tuple(target.tolist()))
    harness.spin_for(4.5)  # longer than what needs no button is left alone
    assert not targets
    np.testing.assert_array_equal(page.value(TARGET), target)
    page.press("Go")
    harness.spin_until(robot.moving, what="the arm to move")
    harness.spin_until(lambda: np.linalg.norm(robot.ball - target) < 0.005, what="the ball there")
    halfway, there = (tuple((robot.ball - [x, 0.0, 0.0]).tolist()) for x in (0.05, 0.1))
    page.drag_target(halfway, there)
    harness.spin_until(robot.moving, what="the arm to move again")
    harness.spin_until(lambda: np.linalg.norm(robot.ball - there) < 0.005, what="the ball there")
    set_target(harness, page, target)
    harness.spin_until(robot.moving, what="the arm to move once more")
    page.press("Stop")
    harness.spin_until(robot.standing, what="zeros")
    assert not any(robot.commands[-1][1].data)
    wait_for_state(harness, page, "READY")
    began_s = time.monotonic()
    assert harness.stop(process, signal.SIGINT) == 0  # though a browser looks
    assert time.monotonic() - began_s < 4.0
    assert "Traceback" not in harness.output(process)


def test_what_the_controller_refuses_stands_on_the_page(loop):
    harness, _, _, _, page = loop

    def stands(name, words):
        return re.search(f'id="fvs-{name}"[^>]*>[^<]*{words}', page.text()) is not None

    set_target(harness, page, (0.0, 0.0, 9.0))
    harness.spin_until(lambda: stands("refusal", "refused: z"), 10.0, "the refusal", page.text)
    start(harness, page)
    harness.spin_until(lambda: page.value("Law") == "ftsm", what="the law that runs")
    page.set("Law", "proportional")
    words = "the law changes only while the arm is stopped; press Stop first"
    harness.spin_until(lambda: stands("answer", words), 10.0, "the refusal", page.text)
    harness.spin_until(lambda: page.value("Law") == "ftsm", what="the law that still runs")
    page.press("Stop")
    wait_for_state(harness, page, "READY")
    page.set("Law", "proportional")
    harness.spin_until(
        lambda: "Scheme: proportional" in page.labels(), what="the other law", story=page.labels
    )


def test_a_controller_that_is_gone_shows_and_a_later_one_waits_for_a_target(ros_module, loop):
    harness, _, controller, process, page = loop
    set_target(harness, page, (0.0, 0.1, 1.4))
    wait_for_state(harness, page, "READY")
    harness.stop(controller)
    wait_for_state(harness, page, "SILENT")
    targets = harness.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)
    refusal = "not done: the controller is silent"
    for wish in (lambda: page.press("Start"), lambda: page.drag_target((0.0, 0.1, 1.4))):
        before = harness.output(process).count(refusal)
        wish()
        harness.spin_until(lambda before=before: harness.output(process).count(refusal) > before)
    harness.spin_until(lambda: refusal in page.text(), what="it on the page")
    assert not targets
    statuses = harness.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    ros_module.keep(CONTROLLER, **PATIENT)

    def reason():
        return ros.from_status(statuses[-1])["reason"] if statuses else ""

    harness.spin_until(lambda: reason() == "NO_TARGET", 20.0, "all inputs but a target")
    harness.spin_for(1.0)
    assert reason() == "NO_TARGET"


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


@pytest.mark.parametrize("prefix", ["camera", "camera/camera"])
def test_images_are_asked_for_only_while_a_browser_looks(loop, pages, prefix):
    harness, _, _, process, page = loop
    image_topic, info_topic = (
        topic.name.replace("camera", prefix, 1)
        for topic in (topics.COLOR_IMAGE, topics.CAMERA_INFO)
    )
    images = harness.node.create_publisher(Image, image_topic, ros.QOS_RELIABLE)
    infos = harness.node.create_publisher(CameraInfo, info_topic, ros.QOS_RELIABLE)
    detector = harness.publisher(DiagnosticStatus, topics.DETECTOR_STATUS.name)
    harness.spin_until(lambda: images.get_subscription_count() == 1, what="a subscription")
    red = np.full((480, 640, 3), (200, 30, 20), np.uint8)
    shown = next(e for e in page.elements.values() if "_format" in e and "uuid" not in e)
    before, sentence = shown["_data"], "no ball of that colour is in the image"

    def pictured():
        infos.publish(ros.to_camera_info(1.0, "camera", CAMERA))
        images.publish(ros.to_image(1.0, "camera", red, "rgb8"))
        detector.publish(ros.to_status(ros.WARN, "fvs_detector_node", sentence, {}))
        return shown["_data"] != before and sentence in page.text()

    harness.spin_until(pictured, 10.0, "a picture", page.text)
    page.close()
    harness.spin_until(lambda: images.get_subscription_count() == 0, what="no subscription")
    pages(address_of(harness, process))
    harness.spin_until(lambda: images.get_subscription_count() == 1, what="a subscription again")


def test_the_simulator_is_disturbed_and_reset_from_the_page(ros_test, pages):
    simulator = ros_test.start_node("fvs_sim_node.node")
    process = ros_test.start_node(DASHBOARD, port=0)
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
    process = ros_test.start_node(DASHBOARD, port=0, tour=True, model_path="models/ur5_front.npz")
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
    ros_test.spin_until(
        lambda: "the tour saw no ball any more" in page.text(), 5.0, "why", page.text
    )
    ros_test.set_parameters("fvs_sim_node", camera_covered=False)
    ros_test.spin_until(lambda: away_rad() > 0.2, 20.0, "the tour to go on", page.text)
    page.press("Stop")
    ros_test.spin_until(lambda: not page.value("Tour"), what="the end of the tour")
    page.press("Reset everything")
    ros_test.spin_until(lambda: away_rad() < 1e-3, 5.0, "the arm where it began", page.text)
    ros_test.spin_until(lambda: "everything reset; target set to" in page.text(), 10.0, "the end")
    wait_for_state(ros_test, page, "READY")
