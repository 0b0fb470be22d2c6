"""Recordings of a UR5's random motion by a camera somewhere, in numpy, for tests."""

from dataclasses import dataclass

import numpy as np
import ur5_dh
from scipy.spatial.transform import Rotation

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.chain import SerialChain
from fvs_ros.filter import Image
from fvs_ros.joints import UR_JOINT_NAMES

_RATE_HZ = 30.0


def rotation_about(axis, angle_rad: float) -> np.ndarray:
    """Rotation matrix, shape (3, 3)."""
    return Rotation.from_rotvec(angle_rad * np.array(axis) / np.linalg.norm(axis)).as_matrix()


def ur5_chain(
    reference_rad: np.ndarray = ur5_dh.HOME_RAD,
    rotation: np.ndarray = ur5_dh.CAMERA_FROM_BASE,
    origin_m: np.ndarray = ur5_dh.CAMERA_ORIGIN_M,
) -> SerialChain:
    """The UR5's chain of its DH table, seen from a camera (its rotation from the base, origin)."""
    axes, points, ball = ur5_dh.axes_origins_ball(reference_rad)
    return SerialChain(
        axes @ rotation.T,
        (points - origin_m) @ rotation.T,
        rotation @ (ball - origin_m),
        reference_rad,
    )


def seen_from_anywhere(rng: np.random.Generator) -> SerialChain:
    """The UR5's chain from a camera that is turned anyhow, the ball 1.4 m before it."""
    rotation = Rotation.random(random_state=rng).as_matrix()
    ball = ur5_dh.axes_origins_ball(ur5_dh.HOME_RAD)[2]
    before = np.array([0.0, 0.0, 1.4]) + 0.2 * rng.normal(size=3)
    return ur5_chain(rotation=rotation, origin_m=ball - rotation.T @ before)


def random_networks(neurons: int = 5) -> RbfModel:
    """Networks for six joints and a ball that nobody trained."""
    rng = np.random.default_rng(0)
    return RbfModel(
        rng.uniform(-1.0, 1.0, (6, neurons, 6)),
        rng.uniform(1.0, 2.5, (6, neurons)),
        rng.normal(size=(6, 3, neurons)),
    )


@dataclass(frozen=True)
class Recording:
    """What a camera records of random motion."""

    seed: int = 0  # of camera, motion and noise
    seconds: float = 60.0
    noise_m: float = 0.001  # standard deviation of each coordinate
    outliers: float = 0.02  # share of positions that are 30 mm off, a standard deviation
    late_s: float = 0.08  # of the images' stamps
    #: Half widths of the joints' box; 0 keeps a joint still.
    reach_rad: tuple[float, ...] = tuple(ur5_dh.BOX_M_RAD)

    def chain(self) -> SerialChain:
        """The chain as it truly is."""
        return seen_from_anywhere(np.random.default_rng([self.seed, 1]))

    def joints(self, time_s: np.ndarray) -> np.ndarray:
        """Where the joints are at times, s: rad, shape (n, 6)."""
        config = MotionConfig(duration_s=self.seconds + 10.0, joint_range_rad=self.reach_rad)
        motion = RandomMotion(ur5_dh.HOME_RAD, config, np.random.default_rng([self.seed, 2]))
        return np.array([motion.path(float(t))[0] for t in time_s])

    def data(self) -> DataSet:
        """The data set."""
        rng = np.random.default_rng([self.seed, 3])
        stamps = np.arange(round(self.seconds * _RATE_HZ)) / _RATE_HZ + 1.0
        ball = self.chain().position(self.joints(stamps - self.late_s))
        ball = ball + self.noise_m * rng.normal(size=ball.shape)
        bad = rng.random(len(ball)) < self.outliers
        ball[bad] += 0.03 * rng.normal(size=(int(bad.sum()), 3))
        run = np.zeros(len(stamps), dtype=int)
        return DataSet(stamps, self.joints(stamps), ball, run, UR_JOINT_NAMES)

    def sampled_joints(self, count: int = 200) -> np.ndarray:
        """Joints anywhere in the box, rad, shape (count, 6)."""
        draws = np.random.default_rng([self.seed, 4]).uniform(-1.0, 1.0, (count, 6))
        return ur5_dh.HOME_RAD + draws * np.array(self.reach_rad)


def image(joints_rad, z, stamp_s=0.0) -> Image:
    """An image of which an estimator observes no path."""
    return Image(stamp_s, joints_rad, z, np.zeros(0), np.zeros(0))


def relative_error(jacobian: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Frobenius norms of the errors over those of the true Jacobians, shape (n,)."""
    return np.linalg.norm(jacobian - true, axis=(-2, -1)) / np.linalg.norm(true, axis=(-2, -1))
