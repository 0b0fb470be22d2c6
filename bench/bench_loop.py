"""What an arm costs over DDS beside a bare rclpy node: CPU and time to the command; and 1 kHz.

``python -m bench loop``. The arm is played by this process, which is not counted.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from harness import Harness, ros_arguments
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from bench.timing import spread
from fvs_ros import ClosedLoop, SimConfig, ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.ball import Ball
from fvs_sim_node.camera import CAMERAS
from fvs_sim_node.robot import HOME_JOINTS_RAD
from fvs_sim_node.simulation import Simulation
from fvs_sim_node.world import World

SECONDS, RATE_HZ, FAST_HZ, ROUNDS, ARM = 8.0, 125.0, 1000.0, 3, "arm"
IMAGE_PERIOD_S, TARGET_PERIOD_S, OFFSET_M = 1.0 / 30.0, 0.8, np.array([0.1, 0.0, 0.05])
CAMERA, CHAIN = CAMERAS["front"], World().chain
#: The longest start, and the motion before it counts, s.
START_S, WARM_UP_S = 30.0, 2.0


class Arm:
    """An arm that moves as told: a light publisher of joint states, ball positions and targets."""

    def __init__(self, context, rate_hz):
        node = rclpy.create_node(
            ARM, context=context, namespace=ARM, start_parameter_services=False
        )
        self._executor, self._clock = EventsExecutor(context=context), node.get_clock()
        self._executor.add_node(node)
        feature, target = Ball.topics.tool.name, Ball.topics.target.name
        self._joints = node.create_publisher(JointState, topics.JOINT_STATES.name, ros.QOS_NEWEST)
        self._balls = node.create_publisher(PointStamped, feature, ros.QOS_NEWEST)
        self._targets = node.create_publisher(PointStamped, target, ros.QOS_LATCHED)
        commands = Float64MultiArray, topics.COMMANDS.name, self._on_command, ros.QOS_RELIABLE
        node.create_subscription(*commands, raw=True)
        self._joints_rad, self._velocity_rad_s = np.array(HOME_JOINTS_RAD), np.zeros(6)
        self._home_m, self._side = self._ball_m(), 1.0
        self._period_s, self._image_s, self._target_s = 1.0 / rate_hz, 0.0, 0.0
        self._sent_s = None  # when the last image went, s, until it is answered
        #: Times to the first command after each image, ms.
        self.answers_ms = []

    def _ball_m(self):
        return CAMERA.to_own(CHAIN.position(self._joints_rad))

    @property
    def moves(self):
        return bool(self._velocity_rad_s.any())

    def _on_command(self, data):
        if self._sent_s is not None:
            self.answers_ms.append(1e3 * (time.monotonic() - self._sent_s))
            self._sent_s = None
        self._velocity_rad_s = np.frombuffer(data[-48:])

    def _step(self, now_s):
        """Move on and send."""
        stamp_s = self._clock.now().nanoseconds * 1e-9
        self._joints_rad = self._joints_rad + self._period_s * self._velocity_rad_s
        if now_s - self._target_s > TARGET_PERIOD_S:
            self._target_s, self._side = now_s, -self._side
            target_m = self._home_m + self._side * OFFSET_M
            self._targets.publish(ros.to_feature(stamp_s, CAMERA_FRAME, Ball(), target_m))
        if now_s - self._image_s > IMAGE_PERIOD_S:
            self._image_s = self._sent_s = now_s
            self._balls.publish(ros.to_feature(stamp_s, CAMERA_FRAME, Ball(), self._ball_m()))
        both = self._joints_rad, self._velocity_rad_s
        self._joints.publish(ros.to_joint_state(stamp_s, UR_JOINT_NAMES, *both))

    def play(self, seconds, until=lambda: False):
        """Send and hear for so many seconds, or until a condition holds."""
        next_s = time.monotonic()
        end_s = next_s + seconds
        while next_s < end_s and not until():
            next_s = max(next_s + self._period_s, time.monotonic())
            while (left_s := next_s - time.monotonic()) > 0.0:
                self._executor.spin_once(timeout_sec=left_s)
            self._step(time.monotonic())


def servo(**scheme):
    """Both nodes in a process."""
    return [("fvs_tools.servo_node", [ARM, *ros_arguments(autostart=True, **scheme)])]


def alone(module, **parameters):
    """A node in a process of its own."""
    return module, ros_arguments({"__ns": f"/{ARM}"}, **parameters)


BARE = "bench.bare_node", [f"{ARM}/{topics.JOINT_STATES.name}", f"{ARM}/{topics.COMMANDS.name}"]
#: Modules of the processes of an arm, and their arguments.
STARTS = {
    "bare, wait sets": [BARE],
    "bare, events executor": [(BARE[0], [*BARE[1], "events"])],
    "two processes": [
        alone("fvs_controller_node.node", autostart=True),
        alone("fvs_estimator_node.node"),
    ],
    "one process": servo(),
}


def _used_s(process):
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run(processes, rate_hz=RATE_HZ):
    """Play an arm for some processes: percent of a core, and times from image to command, ms."""
    with tempfile.TemporaryDirectory() as name, closing(Harness(Path(name))) as harness:
        nodes = [harness.start(module, *arguments) for module, arguments in processes]
        arm = Arm(harness.context, rate_hz)
        arm.play(START_S, lambda: arm.moves)
        if not arm.moves:
            raise RuntimeError("the arm does not move")
        arm.play(WARM_UP_S)
        arm.answers_ms.clear()
        before_s = [_used_s(node) for node in nodes]
        arm.play(SECONDS)
        used_s = [_used_s(node) - used for node, used in zip(nodes, before_s, strict=True)]
    return 100.0 * sum(used_s) / SECONDS, arm.answers_ms


def computed_ms(rate_hz):
    """CPU times of ``best``, ms: of its tick, and of all that follows from a joint state."""
    config = SimConfig(joint_state_rate_hz=rate_hz, rendered=False)
    loop = ClosedLoop.of_scheme("best", Simulation(config), joint_state_rate_hz=rate_hz)
    times_ms = {"observe": [], "command": []}

    def timed(name, function):
        def call(*arguments):
            begin_ns = time.thread_time_ns()
            result = function(*arguments)
            times_ms[name].append(1e-6 * (time.thread_time_ns() - begin_ns))
            return result

        return call

    for name in times_ms:
        setattr(loop, name, timed(name, getattr(loop, name)))
    loop.run(0.5)
    home_m = loop.true_feature
    for side in (1.0, -1.0) * 5:
        loop.set_target(home_m + side * OFFSET_M)
        loop.run(TARGET_PERIOD_S)
    return times_ms["command"], np.sum(list(times_ms.values()), axis=0)


def main():
    runs = {label: [] for label in STARTS}
    for _ in range(ROUNDS):
        for label, processes in STARTS.items():
            runs[label].append(run(processes))
    percents = {label: np.median([percent for percent, _ in runs[label]]) for label in runs}
    print(f"an arm at {RATE_HZ:g} Hz, {ROUNDS} times: percent of a core, times the bare nodes")
    for label, percent in percents.items():
        ratios = "".join(f"{percent / floor:7.2f}" for floor in list(percents.values())[:2])
        print(f"  {label:24s} {percent:5.1f}   {ratios}")
        answers_ms = np.concatenate([answers_ms for _, answers_ms in runs[label]])
        print(f"    image stamp to command {spread(answers_ms, 'ms')}", flush=True)
    fast = servo(method="poe", law="minimum_time", joint_state_rate_hz=FAST_HZ)
    print(f"best at {FAST_HZ:g} Hz, in one process: {run(fast, FAST_HZ)[0]:.1f} %")
    for label, times_ms in zip(("tick", "joint state"), computed_ms(FAST_HZ), strict=True):
        print(f"  computation of a {label:12s} {spread(times_ms, 'ms', 99.9)}")
