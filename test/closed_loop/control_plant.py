"""A UR5 in numpy under the whole controller: drive lag, image latency, noise, wrong Jacobian."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ur5_dh import (
    BOX_M_RAD,
    CAMERA_FROM_BASE,
    CAMERA_ORIGIN_M,
    HOME_RAD,
    axes_origins_ball,
    ball_and_jacobian,
)

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_ros.chain import SerialChain

TICK_S = 0.008
IMAGE_S = 1.0 / 30.0
LATENCY_S = 0.040
NOISE_M = 0.001
FRAME = "camera_color_optical_frame"


class Drive:
    """Zero-order hold of 8 ms, dead time 8 ms, 15 rad/s^2, first-order lag 12 ms, in 2 ms steps."""

    step_s = 0.002

    def __init__(self, joints_rad: np.ndarray) -> None:
        self.joints = joints_rad.copy()
        self._pending = deque([np.zeros(6)] * 8)  # hold and dead time, in steps
        self._ramped = np.zeros(6)
        self.velocity = np.zeros(6)
        self._blend = 1.0 - np.exp(-self.step_s / 0.012)

    def run(self, command: np.ndarray, steps: int) -> None:
        for _ in range(steps):
            self._pending.append(command)
            change = self._pending.popleft() - self._ramped
            most = 15.0 * self.step_s
            self._ramped = self._ramped + np.clip(change, -most, most)
            self.velocity = self.velocity + self._blend * (self._ramped - self.velocity)
            self.joints = self.joints + self.velocity * self.step_s


@dataclass(frozen=True)
class Run:
    """One servoing motion: true error (m) and command (rad/s) at every tick."""

    time_s: np.ndarray
    error_m: np.ndarray
    command: np.ndarray
    states: list[str]
    ball_m: np.ndarray

    def settled_s(self, within_m: float) -> float:
        """When the true error was last above a bound, s from the start; inf if at the end."""
        above = np.flatnonzero(self.error_m > within_m)
        if len(above) == 0:
            return 0.0
        return float(self.time_s[above[-1] + 1]) if above[-1] + 1 < len(self.time_s) else np.inf

    @property
    def final_rms_m(self) -> float:
        """Of the true error over the last second."""
        return float(np.sqrt(np.mean(self.error_m[-125:] ** 2)))

    @property
    def jitter_rad_s(self) -> float:
        """Rms of the command's change from tick to tick over the last second, largest joint."""
        return float(np.sqrt(np.mean(np.diff(self.command[-125:], axis=0) ** 2, axis=0)).max())

    @property
    def unrest_rad_s(self) -> float:
        """Rms of the command itself over the last second, largest joint."""
        return float(np.sqrt(np.mean(self.command[-125:] ** 2, axis=0)).max())


def chain_of_the_arm() -> SerialChain:
    """The arm as a fitted chain would have it, to the bit."""
    axes, points, ball = axes_origins_ball(HOME_RAD)
    seen = (np.vstack([points, ball]) - CAMERA_ORIGIN_M) @ CAMERA_FROM_BASE.T
    return SerialChain(axes @ CAMERA_FROM_BASE.T, seen[:-1], seen[-1], HOME_RAD)


def servo(
    start_rad: np.ndarray,
    goal_rad: np.ndarray,
    *,
    seed: int,
    values: Mapping[str, Any] | None = None,
    duration_s: float = 3.0,
    jacobian_error: float = 0.025,
    noise_m: float = NOISE_M,
    turned: np.ndarray | None = None,
    hidden_s: tuple[float, float] = (0.0, 0.0),
    frozen_s: float = np.inf,
    chain: SerialChain | None = None,
    target_of: Callable[[float], np.ndarray] | None = None,
) -> Run:
    """Servo from rest at one joint vector to the ball position of another.

    ``turned`` is a rotation that the estimator does not know of; ``hidden_s`` is when no image
    shows the ball, from the start on; from ``frozen_s`` on all images are alike; ``target_of``
    moves the target with the time since the start, told at the images' rate.
    """
    rng = np.random.default_rng(seed)
    wrong = rng.normal(size=(3, 6))
    wrong *= jacobian_error / np.linalg.norm(wrong)
    loop = ServoLoop(default_values(**(values or {})))
    supervisor = loop.supervisor
    target = ball_and_jacobian(goal_rad)[0]
    assert loop.add_target(target, FRAME)[0]
    told_s = 0.0
    drive = Drive(start_rad)
    images: deque[tuple[float, np.ndarray]] = deque()
    next_image_s = rng.uniform(0.0, IMAGE_S)
    last_seen: np.ndarray | None = None
    times, errors, commands, states, balls = [], [], [], [], []
    started_s = None
    k = 0
    while started_s is None or k * TICK_S - started_s < duration_s:
        t = k * TICK_S
        ball, jacobian = ball_and_jacobian(drive.joints)
        while next_image_s <= t:
            back = drive.velocity * (t - next_image_s)  # joint motion since the exposure
            seen = ball - jacobian @ back + rng.normal(size=3) * noise_m
            if last_seen is not None and t - (started_s or t) >= frozen_s:
                seen = last_seen
            last_seen = seen
            if not hidden_s[0] <= t - (started_s or t) < hidden_s[1]:
                images.append((next_image_s, seen))
            next_image_s += IMAGE_S
        while images and images[0][0] + LATENCY_S <= t:
            stamp, seen = images.popleft()
            loop.add_ball(t, stamp, seen)
        estimate = jacobian + np.linalg.norm(jacobian) * wrong
        if chain is not None:
            loop.add_chain(t, chain)
        loop.add_jacobian(t, estimate if turned is None else turned @ estimate)
        loop.add_joints(t, t, drive.joints)
        if target_of is not None and started_s is not None:
            target = target_of(t - started_s)
            if t >= told_s:
                assert loop.add_target(target, FRAME, t)[0]
                told_s = t + IMAGE_S
        command = loop.tick(t, TICK_S)
        if started_s is None and command.reason.name == "READY":
            assert supervisor.start(t)[0]
            started_s = t
        elif started_s is not None:
            states.append(command.reason.name)
            times.append(t - started_s)
            errors.append(float(np.linalg.norm(ball - target)))
            balls.append(ball)
            commands.append(command.velocity_rad_s)
        drive.run(command.velocity_rad_s, round(TICK_S / Drive.step_s))
        k += 1
    return Run(np.array(times), np.array(errors), np.array(commands), states, np.array(balls))


def pairs(count: int, seed: int, low_m: float = 0.2, high_m: float = 0.5) -> list[np.ndarray]:
    """Start and goal joints in box M whose balls are 0.2 to 0.5 m apart, (count, 2, 6)."""
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        both = HOME_RAD + rng.uniform(-1.0, 1.0, (2, 6)) * BOX_M_RAD
        balls = ball_and_jacobian(both)[0]
        if low_m <= np.linalg.norm(balls[0] - balls[1]) <= high_m:
            found.append(both)
    return found
