"""A robot and a camera that the package has never seen: six random axes, a random view, in numpy.

Nothing here is shared with the simulator: another kinematics (random screw axes), another drive,
another camera, white noise on the ball positions. It answers to the same calls as the package's
simulation, so that the laboratory's ``LockStep`` can drive it; ``stranger_node.py`` puts it behind
the topics.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

#: Middle of the joints' box and its half width: where a collection starts and how far it may go.
REACH_RAD = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])


@dataclass(frozen=True)
class StrangerConfig:
    """What the robot and its camera are like.

    Parameters
    ----------
    seed : int
        Which robot, which camera, and which noise.
    joint_state_rate_hz, image_rate_hz : float
        Joint states and ball positions a second.
    noise_m : float
        Standard deviation of each coordinate of a ball position, m.
    latency_s : float
        From an exposure to its ball position's publication, s.
    lag_s : float
        Time constant of the joints' first-order answer to a command, s.
    """

    seed: int = 0
    joint_state_rate_hz: float = 125.0
    image_rate_hz: float = 30.0
    noise_m: float = 0.001
    latency_s: float = 0.03
    lag_s: float = 0.02


class Kinematics:
    """Six revolute joints with a ball on the last link, seen from a camera.

    Parameters
    ----------
    rng : numpy Generator
        Decides everything.

    Attributes
    ----------
    home_rad : ndarray, shape (6,)
        A pose around which the ball can be moved in every direction.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        while True:
            self._draw(rng)
            box = self.home_rad + REACH_RAD * rng.uniform(-1.0, 1.0, (40, 6))
            least = [np.linalg.svd(self.jacobian(q), compute_uv=False)[-1] for q in box]
            depth = [self.ball(q)[2] for q in box]
            if min(least) > 0.12 and min(depth) > 0.5:
                return

    def _draw(self, rng: np.random.Generator) -> None:
        # As on most arms: a turning base, two parallel axes, then a wrist; all of it tilted.
        axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
        axes += 0.3 * rng.standard_normal((6, 3))
        self._axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        lengths = rng.uniform([0.1, 0.05, 0.3, 0.2, 0.08, 0.05], [0.3, 0.2, 0.5, 0.45, 0.2, 0.15])
        offsets = np.array([[0, 0, 1], [0, 1, 0], [0.3, 0, 1], [1, 0, 0.2], [1, 0, 0], [1, 0, 0]])
        offsets = offsets + 0.2 * rng.standard_normal((6, 3))
        self._offsets = lengths[:, None] * offsets
        self._tool = np.array([0.12, 0.0, 0.0]) + 0.06 * rng.standard_normal(3)
        self.home_rad = np.array([0.0, -0.3, 1.0, 0.2, 0.8, 0.0]) + 0.4 * rng.standard_normal(6)
        self._rotation, self._eye = np.eye(3), np.zeros(3)
        ball = self.ball(self.home_rad)
        # A camera somewhere about a metre and a half away, rolled as it likes.
        away = rng.standard_normal(3)
        away /= np.linalg.norm(away)
        forward = -away
        right = np.cross(forward, rng.standard_normal(3))
        right /= np.linalg.norm(right)
        self._rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        self._eye = ball + rng.uniform(1.2, 1.8) * away

    def _chain(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rotation, origin = np.eye(3), np.zeros(3)
        axes, origins = np.empty((6, 3)), np.empty((6, 3))
        for i, angle in enumerate(joints_rad):
            origin = origin + rotation @ self._offsets[i]
            axes[i], origins[i] = rotation @ self._axes[i], origin
            rotation = rotation @ _turn(self._axes[i], angle)
        return axes, origins, origin + rotation @ self._tool

    def ball(self, joints_rad: np.ndarray) -> np.ndarray:
        """Ball position, camera frame, m, shape (3,)."""
        return self._rotation.T @ (self._chain(joints_rad)[2] - self._eye)

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Its derivative by the joints, m/rad, shape (3, 6)."""
        axes, origins, ball = self._chain(joints_rad)
        return self._rotation.T @ np.cross(axes, ball - origins).T


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


@dataclass(frozen=True)
class Detection:
    """Where the ball was seen, m, shape (3,)."""

    position_m: np.ndarray


@dataclass(frozen=True)
class Seen:
    """A ball position as it is published: exposure, s, and what was seen."""

    stamp_s: float
    detection: Detection


@dataclass(frozen=True)
class Step:
    """After a joint-state period: time, s, joints, rad, and the ball positions published in it."""

    time_s: float
    joints_rad: np.ndarray
    observations: tuple[Seen, ...]


class Stranger:
    """Robot and camera in lock step: velocities in, joints and noisy ball positions out.

    Parameters
    ----------
    config : StrangerConfig
        What they are like.
    """

    _STEP_S = 0.001

    def __init__(self, config: StrangerConfig | None = None) -> None:
        self.config = config or StrangerConfig()
        rng = np.random.default_rng([self.config.seed, 77])
        self.kinematics = Kinematics(rng)
        self._rng = rng
        self._joints = self.kinematics.home_rad.copy()
        self._velocity = np.zeros(6)
        self._command = np.zeros(6)
        self._blend = 1.0 - np.exp(-self._STEP_S / self.config.lag_s)
        self._steps = 0
        self._images = 0
        self._pending: deque[Seen] = deque()
        self.period_s = 1.0 / self.config.joint_state_rate_hz

    @property
    def time_s(self) -> float:
        """Time since the start, s."""
        return self._steps * self._STEP_S

    @property
    def joints_rad(self) -> np.ndarray:
        """Joint positions now, rad, shape (6,)."""
        return self._joints.copy()

    @property
    def ball_m(self) -> np.ndarray:
        """Where the ball truly is, camera frame, m, shape (3,)."""
        return self.kinematics.ball(self._joints)

    def command(self, velocity_rad_s: np.ndarray) -> None:
        """Command joint velocities, rad/s; they hold for ever."""
        velocity = np.asarray(velocity_rad_s, dtype=float)
        assert velocity.shape == (6,), f"a real controller would be deactivated by {velocity}"
        assert np.isfinite(velocity).all(), f"not finite: {velocity}"
        self._command = velocity.copy()

    def advance(self) -> Step:
        """Let one joint-state period pass."""
        for _ in range(round(self.period_s / self._STEP_S)):
            self._velocity = self._velocity + self._blend * (self._command - self._velocity)
            self._joints = self._joints + self._STEP_S * self._velocity
            self._steps += 1
            if self.time_s * self.config.image_rate_hz >= self._images:
                self._images += 1
                noise = self.config.noise_m * self._rng.standard_normal(3)
                self._pending.append(Seen(self.time_s, Detection(self.ball_m + noise)))
        seen = []
        while self._pending and self._pending[0].stamp_s + self.config.latency_s <= self.time_s:
            seen.append(self._pending.popleft())
        return Step(self.time_s, self.joints_rad, tuple(seen))
