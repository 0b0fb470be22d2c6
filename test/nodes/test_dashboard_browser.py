"""The page in a real browser, of a real loop: what a person sees there, and does."""

import os
import re
import shutil
import time

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics

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
    "joint_state_rate_hz:=50",
    "image_rate_hz:=15.0",
    "joint_states_max_age_s:=1.0",
    "ball_max_age_s:=1.0",
    "jacobian_max_age_s:=1.0",
    "stall_time_s:=60.0",
)
#: By software, a larger window costs more.
SIZE = {"width": 1000, "height": 700}
#: A look at the page costs page and test milliseconds.
LOOK_S = 0.15
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
    const names = ["Stop", "Go", "Set current as target", "Reset", "Bump the camera"];
    return {state: banner.dataset.state, said: text("sentence") + text("hint"),
            error: text("error"), answer: text("answer"), refusal: text("refusal"),
            places: [banner, ...names.map(button)].map(box).join(" ")};
}"""
#: Whether the page says that its program has ended.
LOST = "getComputedStyle(document.getElementById('fvs-lost')).opacity"


@pytest.fixture
def page():
    with playwright.sync_playwright() as tool:
        chromium = tool.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        page = chromium.new_page(viewport=SIZE)
        page.add_init_script(SELDOM)
        yield page
        chromium.close()


class Eyes:
    """What is read from the page's own elements, while the test's node goes on listening."""

    def __init__(self, harness, page):
        self.harness = harness
        self.page = page
        self.restarts = True
        self.places = set()  # where banner and buttons were, to the pixel

    def press(self, name):
        self.page.get_by_role("button", name=name, exact=True).click()

    def type_target(self, position_m):
        row = self.page.locator("div:has(> div label)", has_text="x, y, z (m)").last
        for number, value in enumerate(position_m):
            row.locator("input").nth(number).fill(f"{value:.3f}")

    def wait(self, condition, what):
        """Wait; where a machine with too little time had the arm held, do as the page says."""
        next_s = 0.0

        def holds():
            nonlocal next_s
            if time.monotonic() < next_s:
                return False
            next_s = time.monotonic() + LOOK_S
            seen = self.page.evaluate(LOOK)
            self.places.add(seen["places"])
            if condition(seen):
                return True
            if self.restarts and "press Start" in seen["said"]:
                self.press("Start")
            return False

        self.harness.spin_until(holds, 40.0, what, lambda: self.page.inner_text("body"))


def test_a_person_watches_and_stops(ros_test, page):
    given = [argument for name in PATIENT for argument in ("-p", name)]
    launched = ros_test.start("fvs_tools.launcher", "dashboard", "-p", "port:=0", *given)
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE)

    def address():
        return re.search(r"page: (http://\S+)", ros_test.output(launched))

    ros_test.spin_until(lambda: address() is not None, 30.0, "the page")
    failures = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    page.goto(address().group(1))
    page.wait_for_selector("#fvs-error", timeout=60_000)
    page.get_by_role("button", name="Bump the camera").wait_for(timeout=30_000)
    eyes = Eyes(ros_test, page)

    def error_mm(seen):
        return float(re.sub("[^0-9.]", "", seen["error"]) or "nan")

    # The tour moves the arm: the number on the page is seen to go down.
    eyes.wait(lambda seen: seen["state"] == "SERVOING" and error_mm(seen) > 100.0, "a way to go")
    eyes.wait(lambda seen: seen["state"] == "SERVOING" and error_mm(seen) < 10.0, "an arrival")
    assert page.locator("canvas").count() >= 4  # the 3-D view and three curves
    assert page.get_by_label("Estimator").input_value() == "poe"
    assert page.get_by_text("Joint states").is_visible()

    eyes.restarts = False
    eyes.press("Stop")
    count = len(commands)
    eyes.wait(
        lambda _: len(commands) > count + 5 and not np.any([one.data for one in commands[-5:]]),
        "zeros",
    )
    eyes.wait(lambda seen: seen["answer"].startswith("stop: "), "an answer")
    eyes.wait(lambda seen: seen["state"] == "READY", "the stop on the page")
    eyes.type_target([0.0, 0.0, 99.0])
    eyes.press("Go")
    eyes.wait(lambda seen: "target refused" in seen["refusal"], "a refusal")
    assert len(eyes.places) == 1, eyes.places  # nothing moved, whatever was said
    assert failures == []
    eyes.wait(lambda _: page.evaluate(LOST) == "0", "no word of a program that has ended")
    assert ros_test.stop(launched) == 0, ros_test.output(launched)
    page.wait_for_function(f"{LOST} == '1'", timeout=20_000)
    assert "No word from this page's program" in page.inner_text("#fvs-lost")
