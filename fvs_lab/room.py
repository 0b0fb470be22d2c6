"""Any serial arm before any webcams, without physics: drives, encoders, lenses and noise.

It stands in for a :class:`~fvs_sim_node.simulation.Simulation`, whose arms are those of URDFs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_lab.trials import Joints, stable_noise_m
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import Kind
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import PixelChain, PixelChains, Webcam
from fvs_ros.urdf import UrdfJoint
from fvs_sim_node.actuator import Actuator
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.config import SimConfig

#: Of each picture, px.
SIZE_PX = np.array([640.0, 480.0])
#: Least area of a tag's corners, over the square about them: a detector reads none more aslant.
LEAST_AREA = 0.25


@dataclass(frozen=True)
class Noise:
    """What disturbs images and encoders."""

    #: Standard deviation of a coordinate, px, and exponent of its tails, as of a ball position.
    white_px: float = 0.3
    exponent: float = 2.0
    #: Share of the images that are further off, and standard deviation of that, px.
    outliers: float = 0.0
    outlier_px: float = 20.0
    #: Of each joint angle, rad.
    encoder_rad: float = 0.0

    def blurred(self, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Measurements, (k, m) px, with noise."""
        noise_px = self.white_px * rng.normal(size=z.shape)
        if self.exponent < 2.0:
            scale_m = Points.pixel_m * self.white_px
            noise_px = stable_noise_m(scale_m, self.exponent, rng, z.shape) / Points.pixel_m
        outlying = rng.random((len(z), 1)) < self.outliers
        return z + noise_px + outlying * self.outlier_px * rng.normal(size=z.shape)


class Room:
    """One arm before one webcam or two, by its chain before each.

    It moves about its home, in a box of these half widths, rad, (n,).
    """

    def __init__(
        self, chains: Sequence[PixelChain], home_rad: np.ndarray, box_rad: np.ndarray, noise: Noise
    ) -> None:
        self.chains, self.noise = chains, noise
        self.home_rad, self.box_rad = home_rad, box_rad
        names = ("",) if len(chains) == 1 else ("front", "side")
        self.kind = Points(chains[0].numbers // 2, cameras=names)
        rate_hz = SimConfig.joint_state_rate_hz
        self.config = SimConfig(feature=Points.name, points=self.kind, physics_rate_hz=rate_hz)
        limits = np.full(len(home_rad), 2.0 * np.pi)
        self._actuator = Actuator(self.config, -limits, limits, 0.5 * limits)
        joints = [UrdfJoint(f"joint_{i + 1}", "revolute", "", "") for i in range(len(limits))]
        self.world = SimpleNamespace(joints=joints, joint_names=[joint.name for joint in joints])
        self.reset(home_rad)

    def reset(self, joints_rad: Joints | np.ndarray, seed: int = 0) -> None:
        """Start again at rest at these joints, rad, (n,), with the seed's noise."""
        self._rng, self._ticks, self._images = np.random.default_rng(seed), 0, 0
        self.joints_rad = np.array(joints_rad, dtype=float)
        self._pending: deque[Any] = deque()
        self._actuator.reset()

    @property
    def time_s(self) -> float:
        """Simulated time, s."""
        return self._ticks / self.config.joint_state_rate_hz

    def command(self, velocity_rad_s: np.ndarray) -> None:
        """Set the drives' command, rad/s, (n,)."""
        self._actuator.command(velocity_rad_s)

    def advance(self) -> SimpleNamespace:
        """Advance by one joint-state period."""
        joints, stamp_s = self.joints_rad, self.time_s
        if stamp_s * self.config.image_rate_hz >= self._images:
            self._images += 1
            for number, chain in enumerate(self.chains):
                z = self.noise.blurred(chain.position(joints)[None], self._rng)[0]
                image = {"number": number, "z": z, "object_z": None}
                self._pending.append(SimpleNamespace(stamp_s=stamp_s, joints_rad=joints, **image))
        velocity_rad_s = self._actuator.step(joints)
        self.joints_rad = joints + velocity_rad_s / self.config.joint_state_rate_hz
        self._ticks += 1
        shown = []
        while self._pending and self._pending[0].stamp_s + self.config.latency_s <= self.time_s:
            shown.append(self._pending.popleft())
        noise_rad = self.noise.encoder_rad * self._rng.normal(size=joints.size)
        return SimpleNamespace(
            time_s=self.time_s, joints_rad=self.joints_rad + noise_rad, observations=shown
        )

    def true_chain(self, kind: Kind | None = None) -> PixelChains:
        """The arm as the cameras see it."""
        return PixelChains(tuple(self.chains))

    def true_jacobian(self, joints_rad: np.ndarray, kind: Kind | None = None) -> np.ndarray:
        """Exact Jacobian, m/rad, (d, n)."""
        return self.kind.along(self.true_chain(), joints_rad)[1]

    def true_feature(self) -> np.ndarray:
        """The pixels now, (m,)."""
        return self.true_chain().position(self.joints_rad)

    def as_seen(self, z: np.ndarray) -> np.ndarray:
        """What the cameras report, but for noise: (m,)."""
        return z

    def sees(self, joints_rad: np.ndarray) -> np.ndarray:
        """At which joints, rad, (k, n), all cameras see all points, bool (k,)."""
        return np.all([visible(chain.position(joints_rad)) for chain in self.chains], axis=0)

    def collect(self, seed: int, duration_s: float) -> list[DataSet]:
        """What each camera shows of the collector's motion, for a time, s."""
        names, wide = tuple(self.world.joint_names), (9.0,) * len(self.home_rad)
        config = MotionConfig(
            joint_names=names,
            duration_s=3600.0,  # its end, which is slow, is never reached
            joint_range_rad=tuple(self.box_rad),
            joint_min_rad=tuple(-np.array(wide)),
            joint_max_rad=wide,
        )
        motion = RandomMotion(self.home_rad, config, np.random.default_rng([seed, 1]))
        rng = np.random.default_rng([seed, 2])
        stamps_s = np.arange(1.0, 1.0 + duration_s, 1.0 / self.config.image_rate_hz)
        joints = motion.path(stamps_s)[0]
        measured = joints + self.noise.encoder_rad * rng.normal(size=joints.shape)
        sets = []
        for chain in self.chains:
            z = self.noise.blurred(chain.position(joints), rng)
            seen = visible(z)
            run = np.cumsum(np.diff(seen, prepend=False))[seen]
            shown = (stamps_s[seen], measured[seen], z[seen])
            sets.append(DataSet(*shown, run, names, feature=Points.name))
        return sets


def visible(z: np.ndarray) -> np.ndarray:
    """Whether points, (k, m) px, are in the picture, and a tag's corners seen from its front."""
    points = z.reshape(len(z), -1, 2)
    inside = np.all((points > 0.0) & (points < SIZE_PX), axis=(1, 2))
    u, v = np.moveaxis(points, -1, 0)
    area = 0.5 * np.sum(u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1), axis=1)
    widest = np.ptp(points, axis=1).max(axis=1)
    return np.asarray(inside & ((points.shape[1] < 3) | (area > LEAST_AREA * widest**2)))


def before(arm: SerialChain, camera: RigidPose, lens: Webcam) -> PixelChain:
    """An arm, world frame, before a webcam."""
    back = camera.rotation.T
    return PixelChain(arm.moved(back, -back @ camera.position_m), lens)
