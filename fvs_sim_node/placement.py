"""A posture to begin in and a camera to watch from, for an arm of which only the URDF is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fvs_ros.camera import Intrinsics
from fvs_ros.chain import SerialChain
from fvs_sim_node.camera import RigidPose


class Placement:
    """Posture, box of motion, and cameras of an arm with its ball, a chain in the world frame.

    ``lower`` and ``upper``, (n,), are the ends of the joints' ranges, rad; infinite for none.
    """

    def __init__(self, chain: SerialChain, lower: np.ndarray, upper: np.ndarray) -> None:
        self._chain = chain
        self._lower, self._upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        # Half the width of the box of motion: as for the UR5, and at most a quarter of the range.
        self._box_rad = np.minimum(0.5, 0.25 * (self._upper - self._lower))
        rng, joints = np.random.default_rng(0), len(self._box_rad)
        self._postures, self._inside, self._watched = (
            rng.uniform(-1.0, 1.0, (count, joints)) for count in (3000, 64, 64)
        )

    def home(self) -> np.ndarray:
        """The posture about which the ball moves most readily in every direction, rad, (n,).

        There the smallest singular value of the Jacobian is largest, for a ball above the base. The
        box of motion about it lies within the joints' ranges.
        """
        free = 0.5 * (self._upper - self._lower) - self._box_rad
        drawn = 0.5 * (self._upper + self._lower) + self._postures * free
        inside = self._box_rad * self._inside
        best = drawn[np.argsort(-self._readiness(drawn))[:60]]  # only these in their boxes
        worst = [np.quantile(self._readiness(home + inside), 0.05) for home in best]
        return best[int(np.argmax(worst))]

    def _readiness(self, joints_rad: np.ndarray) -> np.ndarray:
        ball_m, jacobian = self._chain.position_and_jacobian(joints_rad)
        smallest = np.linalg.svd(jacobian, compute_uv=False)[..., -1]
        return np.where(ball_m[..., 2] > 0.0, smallest, 0.0)

    def camera(
        self,
        name: str,
        home_rad: np.ndarray,
        intrinsics: Intrinsics,
        hidden: Callable[[np.ndarray, list[RigidPose]], np.ndarray],
        front_m: np.ndarray | None = None,
    ) -> RigidPose:
        """The camera that has the ball in view, all over the box of motion, and least hidden.

        ``hidden`` tells for joints, (n,), from which poses the arm hides the ball. The camera
        ``side`` looks at an angle of 60 to 90 degrees to that at ``front_m``, (3,).
        """
        joints = home_rad + self._box_rad * self._watched
        balls_m = self._chain.position(joints)
        middle_m = 0.5 * (balls_m.max(axis=0) + balls_m.min(axis=0))
        towards = np.arctan2(middle_m[1], middle_m[0])
        poses = [
            self._closest(middle_m, towards + azimuth, elevation, balls_m, intrinsics)
            for elevation in ((1.2,) if name == "overhead" else (0.35, 0.7))
            for azimuth in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
        ]
        if front_m is not None:
            front = (front_m - middle_m) / np.linalg.norm(front_m - middle_m)
            poses = [each for each in poses if 0.0 < -front @ each.rotation[:, 2] < 0.5]
        share = np.mean([hidden(joints_rad, poses) for joints_rad in joints], axis=0)
        far_m = [np.linalg.norm(pose.position_m - middle_m) for pose in poses]
        # One that is a metre closer may see 2 % less.
        return poses[int(np.argmin(share + 0.02 * np.array(far_m)))]

    def _closest(self, middle_m, azimuth, elevation, balls_m, intrinsics) -> RigidPose:
        """The closest pose in a direction with all ball positions, (k, 3), m, in view."""
        up, out = np.sin(elevation), np.cos(elevation)
        direction = np.array([np.cos(azimuth) * out, np.sin(azimuth) * out, up])
        size = np.array([intrinsics.width, intrinsics.height])
        for distance_m in np.geomspace(0.4, 4.0, 50):
            pose = RigidPose.looking(tuple(middle_m + distance_m * direction), tuple(middle_m))
            in_camera_m = pose.to_own(balls_m)
            # A depth camera sees nothing closer; a tenth of the image stays empty at each edge.
            if in_camera_m[:, 2].min() > 0.3:
                shares = intrinsics.project(in_camera_m) / size
                if np.abs(shares - 0.5).max() < 0.4:
                    break
        return pose
