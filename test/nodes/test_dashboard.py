"""The page beside a real controller: it shows, it drives, and it does no harm."""

import contextlib
import os
import re
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PolygonStamped
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import CameraInfo, Image, JointState

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

from harness import PlayedRobot
from page_client import PageClient

from bench import bench_screenshots as screenshots
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME, Intrinsics
from fvs_ros.joints import JointMap
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.points import Points
from fvs_sim_node.robot import HOME_JOINTS_RAD

DASHBOARD = "fvs_dashboard.dashboard_node"
CONTROLLER = "fvs_controller_node.node"
#: The page is tested, not the machine.
PATIENT = {
    **{f"{name}_max_age_s": 1.0 for name in ("joint_states", "ball", "jacobian")},
    "stall_time_s": 60.0,
}
TARGET = "x, y, z (m)"
#: In the scene.
TARGET_NODE, OBJECT_NODE = "/camera/target", "/object"
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


def address_of(harness, process):
    """Where the page is, once it is served."""

    def match():
        return re.search(r"page: (http://\S+)$", harness.output(process), re.M)

    harness.spin_until(lambda: match() or process.poll() is not None, 30.0, "the page")
    assert match(), harness.output(process)
    return match().group(1)


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
    process = ros_module.keep(DASHBOARD, port=0, joint_names=["not", "those"])
    page = pages(address_of(ros_beside, process))
    robot.meet_controller()
    ros_beside.spin_until(lambda: states(page) in ("WAITING", "READY"), 20.0, "all inputs")
    return ros_beside, robot, controller, process, page


def states(page):
    match = re.search(r'data-state="(\w+)"', page.text())
    return match.group(1) if match else ""


def wait_for_state(harness, page, state):
    harness.spin_until(lambda: states(page) == state, 15.0, f"{state} on the page", page.text)


def set_target(page, position):
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


def test_the_arm_goes_where_the_page_says_and_stops_at_a_press(loop):
    harness, robot, _, _, page = loop
    targets = harness.collect(PointStamped, Ball.topics.target.name, ros.QOS_RELIABLE)
    start(harness, page)
    target = np.round(robot.z + [0.1, -0.05, 0.05], 3)
    page.set(TARGET, tuple(target.tolist()))
    harness.spin_for(4.5)  # longer than what needs no button is left alone
    assert not targets
    np.testing.assert_array_equal(page.value(TARGET), target)
    page.press("Go")
    harness.spin_until(robot.moving, what="the arm to move")
    harness.spin_until(lambda: np.linalg.norm(robot.z - target) < 0.005, what="the ball there")
    halfway, there = (tuple((robot.z - [x, 0.0, 0.0]).tolist()) for x in (0.05, 0.1))
    page.drag(TARGET_NODE, halfway, there)
    harness.spin_until(robot.moving, what="the arm to move again")
    page.press("Stop")
    harness.spin_until(robot.standing, what="zeros")
    assert not any(robot.commands[-1][1].data)
    wait_for_state(harness, page, "READY")
    np.testing.assert_allclose(ros.from_feature(targets[-1], Ball(), CAMERA_FRAME, ""), there)


def test_the_joints_are_those_of_the_controller(loop):
    harness, *_, page = loop
    chart = next(e for e in page.elements.values() if "Joint speeds" in str(e.get("title")))

    def labels():
        return [each.get("label") for each in chart["series"]]

    names = ["pan", "lift", "elbow", "wrist 1", "wrist 2", "wrist 3"]
    harness.spin_until(lambda: labels() == ["s", *names, "limit"], what="the joints")
    harness.spin_until(lambda: len(chart["data"]) == 8, what="their speeds")


def test_a_controller_that_is_gone_shows_and_a_later_one_waits_for_a_target(ros_module, loop):
    harness, _, controller, process, page = loop
    set_target(page, (0.0, 0.1, 1.4))
    wait_for_state(harness, page, "READY")
    harness.stop(controller)
    wait_for_state(harness, page, "SILENT")
    targets = harness.collect(PointStamped, Ball.topics.target.name, ros.QOS_RELIABLE)
    refusal = "not done: the controller is silent"
    for wish in (lambda: page.press("Start"), lambda: page.drag(TARGET_NODE, (0.0, 0.1, 1.4))):
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
    page.press("Go there")
    page.press("Stop")
    page.press("Set current as target")  # means no other stop
    harness.spin_until(lambda: "does not answer yet" in page.text(), what="words")
    controller.send_signal(signal.SIGCONT)
    wait_for_state(harness, page, "READY")
    harness.spin_until(lambda: "stop: stopping" in harness.output(process), what="the answer")
    assert "go to reference" not in harness.output(process)  # it would end with a start


def test_what_is_taught_on_the_page_is_gone_to_where_the_object_is(loop, tmp_path):
    harness, robot, _, _, page = loop
    name = "fvs_controller_node"
    assert harness.set_parameters(name, references_path=str(tmp_path / "r.yaml"))[0].successful
    robot.show_object()
    taught_m = robot.from_object()
    page.set("Name", "grasp")
    harness.spin_until(lambda: ">Object</span>" in page.text(), what="the object")
    harness.spin_for(1.0)  # for a mean
    page.press("Teach")
    harness.spin_until(
        lambda: "taught grasp in the frame object" in page.text(), what="it", story=page.text
    )
    label = "grasp: object, 100 %"
    harness.spin_until(lambda: label in page.elements[page.find("Go to")]["options"], what="a list")
    assert "in the object&#x27;s frame" in page.text()
    robot.move_object(-0.06, 0.04, 0.05)
    page.set("Go to", label)

    def there():
        return np.linalg.norm(robot.from_object() - taught_m) < 0.005

    harness.spin_until(there, 30.0, "the arm there", page.text)
    robot.move_object(0.0, -0.03, 0.0)
    x_m, y_m, z_m = robot.object
    drawn_m = 2.0 - z_m, x_m, 0.4 - y_m  # from a level camera, as long as its pose is not known
    harness.spin_until(lambda: np.allclose(page.positions[OBJECT_NODE], drawn_m), what="it")

    def followed():
        return np.allclose(page.positions[TARGET_NODE], robot.object + taught_m, atol=0.002)

    harness.spin_until(followed, what="the target to follow the object", story=page.text)
    page.press("Stop")
    wait_for_state(harness, page, "READY")
    robot.object = None


def test_images_are_asked_for_only_while_a_browser_looks(loop, pages):
    harness, _, _, process, page = loop
    # Under the names of realsense2_camera.
    image_topic, info_topic = (
        topic.name.replace("camera", "camera/camera", 1)
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


def test_a_tour_of_a_simulated_arm_that_is_disturbed_and_reset_from_the_page(ros_test, pages):
    slow = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0, "full_frame_rate_hz": 1.0}
    parameters = {"port": 0, **slow, **PATIENT}
    arguments = (word for item in parameters.items() for word in ("-p", "{}:={}".format(*item)))
    process = ros_test.start("fvs_tools.launcher", "dashboard", *arguments)
    page = pages(address_of(ros_test, process))
    joint_states = ros_test.collect(JointState, topics.JOINT_STATES.name)

    def away_rad():
        last = joint_states[-1]
        joints = JointMap().positions(last.name, last.position)
        return np.abs(joints - HOME_JOINTS_RAD).max()

    def wait(condition, what, timeout_s=20.0):
        ros_test.spin_until(condition, timeout_s, what, page.text)

    wait(lambda: joint_states and away_rad() > 0.2, "the tour to begin", 30.0)
    assert page.value("Tour")
    targets = ros_test.collect(PointStamped, Ball.topics.target.name, ros.QOS_RELIABLE)
    page.press("Stop")
    wait_for_state(ros_test, page, "READY")
    wait(lambda: not page.value("Tour"), "the end of the tour")
    assert not targets

    # The simulator is disturbed, and reset.
    bump = page.elements[page.find("Bump the camera")]
    wait(lambda: bump["visible"], "the simulator's parameters")
    page.press("Bump the camera")
    page.set("Depth noise (×)", 2.5)
    beside = (0.4, 0.1, 0.05)
    page.drag(OBJECT_NODE, beside)
    names = ["depth_noise", "camera_rotation_deg", "object_position_m"]
    request = GetParameters.Request(names=names)

    def disturbances():
        answer = ros_test.call(GetParameters, "fvs_sim_node/get_parameters", request)
        noise, rotation, position = answer.values
        placed = tuple(position.double_array_value)
        return noise.double_value, any(rotation.double_array_value), placed

    wait(lambda: disturbances() == (2.5, True, beside), "the disturbances")
    page.press("Reset")
    wait(lambda: disturbances() == (2.5, False, beside) and away_rad() < 1e-3, "all as it began")
    wait_for_state(ros_test, page, "READY")


def test_the_ball_before_a_webcam_goes_where_its_picture_is_clicked(ros_test, pages):
    slow = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0, "full_frame_rate_hz": 1.0}
    webcam = {"feature": "points", "cameras": "[front]", "tour": "false"}
    parameters = {"port": 0, **webcam, **slow, **PATIENT}
    arguments = (word for item in parameters.items() for word in ("-p", "{}:={}".format(*item)))
    page = pages(
        address_of(ros_test, ros_test.start("fvs_tools.launcher", "dashboard", *arguments))
    )
    kind = Points(cameras=("front",))
    seen = ros_test.collect(PolygonStamped, kind.topics.tool.name)
    targets = ros_test.collect(PolygonStamped, kind.topics.target.name, ros.QOS_RELIABLE)
    ros_test.spin_until(lambda: seen and states(page) == "WAITING", 30.0, "the ball", page.text)
    wanted = kind.read(seen[-1]) + [-40.0, 20.0]
    u, v = (wanted + 0.5) / [640.0, 480.0] - 0.5

    def clicked():  # before the first picture, it means nothing
        x, _, z = page.positions["/picture/0"]
        page.click("/picture/0", (x + u, -1.0, z - 0.75 * v), (0.0, 1.0, 0.0))
        return targets

    # A busy machine draws pictures last.
    ros_test.spin_until(clicked, 120.0, "a target", page.text)
    np.testing.assert_allclose(kind.read(targets[0]), wanted, atol=0.01)

    def there():
        return np.abs(kind.read(seen[-1]) - wanted).max() < 1.0

    ros_test.spin_until(there, 60.0, "the ball there", page.text)


def test_what_is_clicked_on_in_both_pictures_is_tracked_by_the_detector(ros_test, pages):
    rng, cameras = np.random.default_rng(7), ("left", "right")
    spots = np.kron(rng.integers(0, 256, (60, 80, 1)), np.ones((4, 4, 3))).astype(np.uint8)
    images = [
        ros_test.node.create_publisher(
            Image, topics.of_camera(topics.COLOR_IMAGE, name).name, ros.QOS_RELIABLE
        )
        for name in cameras
    ]

    def show():
        for publisher in images:
            publisher.publish(ros.to_image(time.time(), "eye", spots, "rgb8"))

    ros_test.node.create_timer(0.1, show)
    parameters = {"feature": "points", "cameras": list(cameras)}
    address = address_of(ros_test, ros_test.start_node(DASHBOARD, port=0, **parameters))
    # The page has its first pictures before a browser asks for them.
    ros_test.spin_until(lambda: all(each.get_subscription_count() for each in images), 15.0)
    page = pages(address)
    ros_test.start_node("fvs_detector_node.node", **parameters)
    seen = [ros_test.collect(PolygonStamped, f"{name}/image_points") for name in cameras]
    lost = "left: nothing in view has the ball&#x27;s colour"
    ros_test.spin_until(lambda: lost in page.text(), 30.0, "a detector", page.text)
    page.set("A click", "track this")

    def clicked():
        for camera in (0, 1):
            name = f"/picture/{camera}"
            page.click(name, (0.25 * camera, -1.0, page.positions[name][2]), (0.0, 1.0, 0.0))
        return all(seen)

    ros_test.spin_until(clicked, 60.0, "points", page.text)
    for messages, u in zip(seen, (159.5, 239.5), strict=True):
        np.testing.assert_allclose(Points().read(messages[-1]), [u, 119.5], atol=0.2)
    page.press("Track nothing")
    ros_test.spin_until(lambda: lost in page.text(), 15.0, "the ball's absence", page.text)


# ---- in a real browser ------------------------------------------------------------------------

#: All at one look: what the panel says, and where its buttons are.
LOOK = """() => {
    const text = name => document.getElementById(`fvs-${name}`).innerText;
    const box = node => Object.values(node.getBoundingClientRect().toJSON());
    const button = name => [...document.querySelectorAll("button")]
        .find(node => node.innerText == name);
    const names = ["Stop", "Go", "Set current as target"];
    return {state: document.getElementById("fvs-banner").dataset.state,
            error: text("error"), answer: text("answer"), banner: text("banner"),
            boxes: names.map(button).map(box).join(" ")};
}"""
#: Whether the page says that its program has ended.
LOST = "getComputedStyle(document.getElementById('fvs-lost')).opacity"


@pytest.fixture
def window():
    """A window of a browser."""
    pytest.importorskip("playwright", reason="playwright is not installed")
    if screenshots.browser() is None and not os.environ.get("FVS_NEED_BROWSER"):
        pytest.skip("chromium is not installed (apt install chromium)")
    with screenshots.window(1000, 700) as window:
        yield window


def test_a_person_reads_aims_and_stops_in_a_browser(loop, window):
    harness, robot, _, process, _ = loop
    failures, boxes = [], set()
    window.on("pageerror", lambda error: failures.append(str(error)))
    window.goto(address_of(harness, process))
    window.wait_for_selector("#fvs-error", timeout=60_000)
    assert window.locator("canvas").count() >= 4  # the 3-D view and three curves

    def wait(condition, what):
        def holds():
            harness.spin_for(0.3)  # a look costs page and test milliseconds
            look = window.evaluate(LOOK)
            boxes.add(look["boxes"])
            return condition(look)

        harness.spin_until(holds, 40.0, what, lambda: window.inner_text("body"))

    def press(name):
        window.get_by_role("button", name=name, exact=True).click()

    def aim(position_m):
        row = window.locator("div:has(> div label)", has_text=TARGET).last
        for number, value in enumerate(position_m):
            row.locator("input").nth(number).fill(f"{value:.3f}")
        press("Go")

    def error_mm(look):
        return float(re.sub("[^0-9.]", "", look["error"]) or "nan")

    # While the browser is busy this process is, too, and so the played robot: it stands.
    aim(robot.z + [0.15, -0.05, 0.05])
    wait(lambda look: look["state"] == "READY" and error_mm(look) > 100.0, "a way to go")
    aim(robot.z)
    wait(lambda look: error_mm(look) < 10.0, "a way of nothing")
    press("Stop")
    wait(lambda look: look["answer"].startswith("stop: "), "an answer")
    aim([0.0, 0.0, 99.0])
    wait(lambda look: "target refused" in look["banner"], "a refusal")
    assert len(boxes) == 1, boxes  # nothing moved, whatever was said
    assert failures == []
    wait(lambda _: window.evaluate(LOST) == "0", "no word of a program that has ended")
    harness.stop(process)
    window.wait_for_function(f"{LOST} == '1'", timeout=20_000)
    assert "No word from this page's program" in window.inner_text("#fvs-lost")
