"""What the page costs the loop: latency and jitter without it, with it, and while it is looked at.

python -m bench dashboard [--browser]

The real loop (simulator, estimator, controller) goes from target to target all the time; beside it
stand, in turn, nothing, an unwatched page, and a page with a client. The client is a
websocket that reads all that a browser would, or, with --browser, a headless chromium, which draws
by software on the same cores. Times are taken by a fourth process that hears the topics.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Harness
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_estimator_node.files import load_model
from fvs_ros import ros, topics
from fvs_ros.paths import find_file
from fvs_tools.demo import choose_target
from fvs_tools.scenario import load_scenario

_CLIENT = "import sys, time, page_client as p; p.PageClient(sys.argv[1]); time.sleep(600.0)"
ROUNDS = 6
CONDITIONS = ("no page", "page, unwatched", "page, watched")


class Watch:
    """Hears the loop: when commands came, and how old the newest image was then."""

    def __init__(self, harness):
        self._harness = harness
        self._rng = np.random.default_rng(0)
        self._candidates = load_model(find_file("models/ur5_front.npz")).ball_samples_m
        node = harness.node
        self._targets = node.create_publisher(
            PointStamped, topics.TARGET_POSITION.name, ros.QOS_LATCHED
        )
        self._balls = harness.collect(PointStamped, topics.BALL_POSITION.name)
        self.commands_s, self._latency_s, self._seen = [], [], 0
        node.create_subscription(
            Float64MultiArray, topics.COMMANDS.name, self._on_command, ros.QOS_RELIABLE
        )

    def _on_command(self, _message):
        self.commands_s.append(time.monotonic())
        if len(self._balls) > self._seen:
            self._seen = len(self._balls)
            self._latency_s.append(time.time() - ros.from_stamp(self._balls[-1].header.stamp))

    def ready(self):
        return bool(self._balls) and len(self.commands_s) > 50

    def measure(self):
        """Medians and 99th percentiles, ms: image stamp to command, and a command off its 8 ms."""
        # After some hundred targets the wrist may hide the ball, and the arm stands.
        self._harness.call(Trigger, "fvs_sim_node/reset")
        self._run(2.0)
        self.commands_s.clear()
        self._latency_s.clear()
        self._run(8.0)
        off_s = np.abs(np.diff(self.commands_s) - 0.008)
        return 1e3 * np.ravel([np.percentile(one, [50, 99]) for one in (self._latency_s, off_s)])

    def _run(self, seconds):
        end_s, next_s = time.monotonic() + seconds, 0.0
        while time.monotonic() < end_s:
            if time.monotonic() > next_s:
                ball = self._balls[-1]
                position_m = ros.from_point(ball, ball.header.frame_id, topics.BALL_POSITION.name)
                target_m = choose_target(self._candidates, position_m, 0.3, self._rng)
                self._targets.publish(ros.to_point(time.time(), ball.header.frame_id, target_m))
                next_s = time.monotonic() + 3.0
            self._harness.executor.spin_once(timeout_sec=0.02)


@contextlib.contextmanager
def beside(harness, condition, browser):
    """What stands beside the loop."""
    if condition == CONDITIONS[0]:
        yield
        return
    process = harness.start_node("fvs_dashboard.dashboard_node", port=0)

    def address():
        return re.findall(r"page: (http://\S+)", harness.output(process))

    harness.spin_until(address, 60.0, "the page")
    looks = (chromium if browser else client)(address()[0])
    with looks if condition == CONDITIONS[2] else contextlib.nullcontext():
        yield
    harness.stop(process)


@contextlib.contextmanager
def client(address):
    # In a process of its own, as a browser is: its reading must not hold up the watch.
    looks = subprocess.Popen([sys.executable, "-c", _CLIENT, address])
    yield
    looks.kill()
    looks.wait()


@contextlib.contextmanager
def chromium(address):
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
    with sync_playwright() as tool:
        window = tool.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = window.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.wait_for_selector("#fvs-error", timeout=60_000)
        yield
        window.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--browser", action="store_true")
    arguments = parser.parse_args()
    print("client: " + ("headless chromium" if arguments.browser else "websocket, draws nothing"))
    pictures_hz = load_scenario("dashboard")["fvs_sim_node"]["full_frame_rate_hz"]
    results = {condition: [] for condition in CONDITIONS}
    with tempfile.TemporaryDirectory() as name, contextlib.closing(Harness(Path(name))) as harness:
        harness.start("fvs_tools.launcher", "servo", "-p", f"full_frame_rate_hz:={pictures_hz}")
        watch = Watch(harness)
        harness.spin_until(watch.ready, 60.0, "the loop")
        for _ in range(ROUNDS):
            for condition in CONDITIONS:
                with beside(harness, condition, arguments.browser):
                    results[condition].append(watch.measure())
    # Medians over the rounds, and the median ratio to the block without a page before it.
    print(f"{'':22}  image stamp to command, ms        commands off 8 ms, ms")
    print(f"{'':22}      p50            p99            p50            p99")
    for condition, rows in results.items():
        ratios = np.median(np.divide(rows, results[CONDITIONS[0]]), axis=0)
        cells = "  ".join(
            f"{v:6.2f} (x{r:4.2f})" for v, r in zip(np.median(rows, axis=0), ratios, strict=True)
        )
        print(f"{condition:22}  {cells}")
