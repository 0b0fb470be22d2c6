"""The page in a real browser, of a real loop: what a person sees there, and does."""

from __future__ import annotations

import os
import re
import shutil
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64MultiArray

from fvs_estimator_node.model_file import load_model
from fvs_ros import ros, topics
from fvs_ros.paths import find_file
from fvs_tools.demo import choose_target

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")
playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (pip install playwright)"
)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("FVS_NEED_BROWSER"),
    reason="chromium is not installed (apt install chromium)",
)

#: Headless, drawing WebGL by software, and saying nothing to the world.
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
#: Drawn some times a second only: by software every picture takes a core for tens of milliseconds.
SELDOM = "window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 250)"
#: The page is tested, not the machine, which draws the browser's pictures beside the loop.
PATIENT = (
    "full_frame_rate_hz:=1.0",
    "joint_states_max_age_s:=1.0",
    "ball_max_age_s:=1.0",
    "jacobian_max_age_s:=1.0",
    "follow_time_s:=30.0",
)
#: By software, a larger window costs more.
SIZE = {"width": 1000, "height": 700}
#: A look at the page costs page and test milliseconds.
LOOK_S = 0.15
TARGET = "x, y, z (m)"
#: All at one look: what the panel says, and where its buttons and the banner are.
LOOK = """() => {
    const text = name => document.getElementById(`fvs-${name}`).innerText;
    const box = node => {
        const {left, top, right, bottom} = node.getBoundingClientRect();
        return [left, top, right, bottom];
    };
    const button = name => [...document.querySelectorAll("button")]
        .find(one => one.innerText == name);
    const banner = document.getElementById("fvs-banner");
    const names = ["Stop", "Go", "Set current as target", "Reset everything", "Bump the camera"];
    return {state: banner.dataset.state, said: text("sentence") + text("hint"),
            answer: text("answer"), stop: box(button("Stop")),
            places: [banner, ...names.map(button)].map(box).join(" ")};
}"""

#: Whether the page says that its program has ended.
LOST = "getComputedStyle(document.getElementById('fvs-lost')).opacity"


@pytest.fixture
def browser():
    with playwright.sync_playwright() as tool:
        chromium = tool.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield chromium
        chromium.close()


class Eyes:
    """What is read from the page's own elements, while the test's node goes on listening."""

    def __init__(self, harness, page):
        self.harness = harness
        self.page = page
        self.started = True
        self.next_s = 0.0
        self.places = set()  # where banner and buttons were, to the pixel
        self.states = set()
        self.answers = set()

    def state(self):
        return self.page.get_attribute("#fvs-banner", "data-state")

    def stop_box(self):
        """Left, top, right and bottom of Stop, pixels."""
        return tuple(round(edge) for edge in self.page.evaluate(LOOK)["stop"])

    def look(self):
        """Note what has been there at one time or another; what the banner says now."""
        seen = self.page.evaluate(LOOK)
        self.places.add(seen["places"])
        self.states.add(seen["state"])
        self.answers.add(seen["answer"])
        return seen["said"]

    def error_mm(self):
        found = re.fullmatch(r"([\d.]+) mm", self.page.inner_text("#fvs-error"))
        return float(found.group(1)) if found else float("nan")

    def wait(self, condition, what, timeout_s=30.0):
        """Wait; where a machine with too little time had the arm held, do as the page says."""

        def so_now():
            if time.monotonic() < self.next_s:
                return False
            self.next_s = time.monotonic() + LOOK_S
            said = self.look()
            if condition():
                return True
            if "press Start" in said and self.started:
                self.page.get_by_role("button", name="Start", exact=True).click()
            return False

        self.harness.spin_until(so_now, timeout_s, what, lambda: self.page.inner_text("body"))

    def type_target(self, position_m):
        row = self.page.locator("div:has(> div label)", has_text=TARGET).last
        for number, value in enumerate(position_m):
            row.locator("input").nth(number).fill(f"{value:.3f}")


@pytest.mark.timeout(240)  # half a minute where nothing else runs
def test_a_person_watches_sets_a_target_and_stops(ros_test, browser):
    given = [argument for name in PATIENT for argument in ("-p", name)]
    launched = ros_test.start("fvs_tools.launcher", "dashboard", "-p", "port:=0", *given)
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE)
    statuses = ros_test.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    balls = ros_test.collect(PointStamped, topics.BALL_POSITION.name)
    targets = ros_test.collect(PointStamped, topics.TARGET_POSITION.name, ros.QOS_RELIABLE)

    def address():
        return re.search(r"page: (http://\S+)", ros_test.output(launched))

    ros_test.spin_until(lambda: address() is not None, 30.0, "the page")
    page = browser.new_page(viewport=SIZE)
    page.add_init_script(SELDOM)
    failures = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    page.goto(address().group(1))
    page.wait_for_selector("#fvs-error", timeout=60_000)
    page.get_by_role("button", name="Bump the camera").wait_for(timeout=30_000)
    eyes = Eyes(ros_test, page)

    # The tour moves the arm: the number on the page is seen to go down.
    eyes.wait(lambda: eyes.state() == "SERVOING" and eyes.error_mm() > 100.0, "a way to go")
    eyes.wait(lambda: eyes.state() == "SERVOING" and eyes.error_mm() < 10.0, "an arrival")
    assert page.locator("canvas").count() >= 4  # the 3-D view and three curves
    assert page.get_by_text("Scheme: proposed").is_visible()
    assert page.get_by_text("Joint states").is_visible()

    # A target by its numbers.
    rng = np.random.default_rng(0)
    candidates = load_model(find_file("models/ur5_front.npz")).ball_samples_m

    def ball():
        point = balls[-1].point
        return np.array([point.x, point.y, point.z])

    def go_somewhere():
        wanted = np.round(choose_target(candidates, ball(), 0.25, rng), 3)
        eyes.type_target(wanted)

        def heard():
            page.get_by_role("button", name="Go", exact=True).click()
            ros_test.spin_for(0.1)
            newest = targets[-1].point
            return np.allclose([newest.x, newest.y, newest.z], wanted, atol=6e-4)

        eyes.wait(heard, "the target on its topic")
        return wanted

    wanted = go_somewhere()
    eyes.wait(lambda: np.linalg.norm(ball() - wanted) < 0.01, "the ball at the target")

    # Stop on the way to another.
    go_somewhere()
    eyes.wait(lambda: np.any(commands[-1].data), "a motion")
    eyes.started = False
    page.get_by_role("button", name="Stop", exact=True).click()
    count = len(commands)
    eyes.wait(
        lambda: (
            len(commands) > count + 5
            and all(list(command.data) == [0.0] * 6 for command in commands[-5:])
        ),
        "six zeros",
    )
    eyes.wait(lambda: eyes.state() == "READY", "the stop on the page")
    eyes.wait(lambda: any(one.startswith("stop: ") for one in eyes.answers), "an answer")
    eyes.type_target([0.0, 0.0, 99.0])
    page.get_by_role("button", name="Go", exact=True).click()
    eyes.wait(lambda: "target refused" in page.inner_text("#fvs-refusal"), "a refusal")
    assert "refused" not in eyes.look()
    page.get_by_role("button", name="Bump the camera").click()
    page.get_by_role("button", name="Reset everything").click()
    eyes.wait(lambda: any("everything reset" in one for one in eyes.answers), "a reset")
    assert {"SERVOING", "READY"} <= eyes.states
    assert "" in eyes.answers
    assert len(eyes.places) == 1, eyes.places  # nothing moved, whatever was said
    check_layout(eyes, page)
    page.set_viewport_size(SIZE)
    assert ros.from_status(statuses[-1])["state"] == "READY"
    assert failures == []
    eyes.wait(lambda: page.evaluate(LOST) == "0", "no talk of a program that has ended")
    assert ros_test.stop(launched) == 0, ros_test.output(launched)
    page.wait_for_function(f"{LOST} == '1'", timeout=20_000)
    assert "No word from this page's program" in page.inner_text("#fvs-lost")


def check_layout(eyes, page):
    """What is usually looked at fits a small screen, and Stop stays where it is."""
    page.set_viewport_size({"width": 1366, "height": 768})
    folder = page.get_by_text("Simulator: disturb it")
    bump = page.get_by_role("button", name="Bump the camera")
    eyes.wait(lambda: bump.bounding_box()["x"] > 1000, "the other size")
    assert bump.bounding_box()["y"] < 600  # and some of the picture below it
    stop = eyes.stop_box()
    charts = page.locator(".uplot")
    assert charts.count() == 3
    lowest = max(box["y"] + box["height"] for box in (one.bounding_box() for one in charts.all()))
    assert lowest < 768
    size = "getComputedStyle(document.getElementById('fvs-sentence')).fontSize"
    assert float(page.evaluate(size).removesuffix("px")) >= 14.0
    folder.dispatch_event("click")
    slider = page.get_by_text("Latency (s)", exact=False)
    eyes.wait(slider.is_visible, "the sliders")

    def scrolled():  # the folder is still unfolding
        slider.evaluate("node => node.scrollIntoView({block: 'center'})")
        return slider.bounding_box()["y"] < 768

    eyes.wait(scrolled, "the last slider")
    assert eyes.stop_box() == stop  # on top of what is scrolled
    hit = "([x, y]) => document.elementFromPoint(x, y).closest('button')?.innerText"
    left, top, right, bottom = stop
    for x in (left + 4, right - 4):  # and under no scroll bar
        assert "Stop" in page.evaluate(hit, [x, (top + bottom) // 2])
