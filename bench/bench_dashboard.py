"""What the page costs the loop: latency and jitter without it, with it, and while it is looked at.

python bench/bench_dashboard.py [--rounds N] [--browser]

The real loop (simulator, estimator, controller) goes from target to target all the time; beside it
stand, in turn, nothing, a page that nobody looks at, and a page with a client. The client is a
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
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Harness
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_estimator_node.model_file import load_model
from fvs_ros import ros, topics
from fvs_ros.paths import find_file
from fvs_tools.demo import choose_target
from fvs_tools.scenario import load_scenario

DASHBOARD = "fvs_dashboard.dashboard_node"
PICTURES_HZ = load_scenario("dashboard")["fvs_sim_node"]["full_frame_rate_hz"]
PERIOD_S, BLOCK_S, SETTLE_S, TARGET_S = 0.008, 8.0, 2.0, 3.0
_CLIENT = "import sys, time, page_client as p; p.PageClient(sys.argv[1]); time.sleep(600.0)"
CONDITIONS = ("no page", "page, nobody looks", "page, a client looks")


class Watch:
    """Hears the loop: when commands came, and how old the newest image was then."""

    def __init__(self, harness: Harness) -> None:
        self._harness = harness
        self._rng = np.random.default_rng(0)
        self._candidates = load_model(find_file("models/ur5_front.npz")).ball_samples_m
        self._targets = harness.node.create_publisher(
            PointStamped, topics.TARGET_POSITION.name, ros.QOS_LATCHED
        )
        self._ball: PointStamped | None = None
        self._fresh = False
        self.commands: list[tuple[float, bool]] = []
        self.latency_s: list[float] = []
        node = harness.node
        node.create_subscription(
            PointStamped, topics.BALL_POSITION.name, self._on_ball, ros.QOS_NEWEST
        )
        node.create_subscription(
            Float64MultiArray, topics.COMMANDS.name, self._on_command, ros.QOS_RELIABLE
        )

    def _on_ball(self, message: PointStamped) -> None:
        self._ball, self._fresh = message, True

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands.append((time.monotonic(), any(message.data)))
        if self._fresh and self._ball is not None:
            self._fresh = False
            self.latency_s.append(time.time() - ros.from_stamp(self._ball.header.stamp))

    def ready(self) -> bool:
        return self._ball is not None and len(self.commands) > 50

    def measure(self) -> tuple[np.ndarray, np.ndarray]:
        """Image stamp to command, s, and how much later than 8 ms the next command came, s."""
        # After some hundred targets the wrist may hide the ball, and the arm stands.
        self._harness.call(Trigger, "fvs_sim_node/reset")
        self._run(SETTLE_S)
        self.commands.clear()
        self.latency_s.clear()
        self._run(BLOCK_S)
        intervals = np.diff([at for at, _ in self.commands])
        return np.array(self.latency_s), np.abs(intervals - PERIOD_S)

    def _run(self, seconds: float) -> None:
        end_s, next_s = time.monotonic() + seconds, 0.0
        while time.monotonic() < end_s:
            if time.monotonic() > next_s and self._ball is not None:
                point = self._ball.point
                ball = np.array([point.x, point.y, point.z])
                target = choose_target(self._candidates, ball, 0.3, self._rng)
                now_s = self._harness.node.get_clock().now().nanoseconds * 1e-9
                frame = self._ball.header.frame_id
                self._targets.publish(ros.to_point(now_s, frame, target))
                next_s = time.monotonic() + TARGET_S
            self._harness.executor.spin_once(timeout_sec=0.02)


@contextlib.contextmanager
def beside(harness: Harness, condition: str, browser: bool) -> Iterator[None]:
    """What stands beside the loop."""
    if condition == CONDITIONS[0]:
        yield
        return
    process = harness.start_node(DASHBOARD, port=0)

    def address() -> re.Match | None:
        return re.search(r"page: (http://\S+)", harness.output(process))

    harness.spin_until(lambda: address() is not None, 60.0, "the page")
    found = address()
    assert found is not None
    with contextlib.ExitStack() as stack:
        if condition == CONDITIONS[2]:
            looks = chromium(found[1]) if browser else client(found[1])
            stack.enter_context(looks)
        yield
    harness.stop(process)


@contextlib.contextmanager
def client(address: str) -> Iterator[None]:
    # In a process of its own, as a browser is: its reading must not hold up the watch.
    looks = subprocess.Popen([sys.executable, "-c", _CLIENT, address])
    yield
    looks.kill()
    looks.wait()


@contextlib.contextmanager
def chromium(address: str) -> Iterator[None]:
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
    with sync_playwright() as tool:
        window = tool.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = window.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.wait_for_selector("#fvs-error", timeout=60_000)
        yield
        window.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--browser", action="store_true")
    arguments = parser.parse_args()
    print("client: " + ("headless chromium" if arguments.browser else "websocket, draws nothing"))
    results: dict[str, list[np.ndarray]] = {condition: [] for condition in CONDITIONS}
    with tempfile.TemporaryDirectory() as name:
        harness = Harness(Path(name))
        try:
            harness.start("fvs_tools.launcher", "servo", "-p", f"full_frame_rate_hz:={PICTURES_HZ}")
            watch = Watch(harness)
            harness.spin_until(watch.ready, 60.0, "the loop")
            for _ in range(arguments.rounds):
                for condition in CONDITIONS:
                    with beside(harness, condition, arguments.browser):
                        latency_s, off_s = watch.measure()
                    numbers = np.concatenate(
                        [np.percentile(one, [50, 99]) for one in (latency_s, off_s)]
                    )
                    results[condition].append(1e3 * numbers)
        finally:
            harness.close()
    report(results)


def report(results: dict[str, list[np.ndarray]]) -> None:
    """Medians over the rounds, and the median ratio to the block without a page before it."""
    print(f"{'':22}  image stamp to command, ms        commands off 8 ms, ms")
    print(f"{'':22}      p50            p99            p50            p99")
    without = np.array(results[CONDITIONS[0]])
    for condition, rows in results.items():
        values = np.array(rows)
        ratios = np.median(values / without, axis=0)
        cells = "  ".join(
            f"{v:6.2f} (x{r:4.2f})" for v, r in zip(np.median(values, axis=0), ratios, strict=True)
        )
        print(f"{condition:22}  {cells}")
