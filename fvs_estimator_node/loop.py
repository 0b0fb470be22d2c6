"""The whole estimator without ROS: track, steps and method in one object.

The node passes messages in and publishes the results; the laboratory uses the same object.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_ros.filter import Image
from fvs_ros.interface import Backlash
from fvs_ros.pixel_chain import PixelChains
from fvs_ros.track import Track
from fvs_ros.vectors import all_finite, largest

#: Least motion of the fastest joint in a step, rad: it moves the ball by some millimetres, more
#: than the noise of its position. Longest step, s: slow arms drift.
_MIN_STEP_RAD, _MAX_STEP_S = 0.01, 0.5
#: Largest age of an input, s; an older sliding variable counts as zero.
FRESH_S = 0.2


class EstimationLoop:
    """Joint states and images in; Jacobian, chain and status out.

    Outliers are left out, as in the controller. A step ends at the first image whose joints have
    moved enough since the step's first image, and the next one begins there. After a timeout it
    begins at the newest image.
    """

    def __init__(self, estimator: Estimator) -> None:
        self.estimator, self.kind = estimator, estimator.kind
        self._backlash = Backlash()
        self.learns = True  #: off, the estimator learns nothing
        #: Pair the images of each camera with joints, and judge them.
        self.tracks = [Track(part) for part in self.kind.parts]
        self._forget()

    def reset(self) -> None:
        """Forget what was learned online, and all inputs."""
        self.estimator.reset()
        self.lose_joints()
        self._forget()

    def _forget(self) -> None:
        self.steps = 0  #: how many it learned from
        self._jacobian: np.ndarray | None = None  # the newest
        #: Where the present step of each camera began.
        self._anchors: list[Image | None] = [None for _ in self.tracks]
        self._sliding: tuple[float, np.ndarray] | None = None

    # --- inputs ---

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Take a joint state, s and rad, (n,)."""
        chain = self.estimator.chain
        joints_rad = self._backlash.joints(joints_rad, 0.0 if chain is None else chain.play_rad)
        for camera, (track, rows) in enumerate(zip(self.tracks, self.kind.rows, strict=True)):
            jacobian = None if self._jacobian is None else self._jacobian[rows]
            self._learn(camera, track.add_joints(stamp_s, joints_rad, jacobian))

    def lose_joints(self) -> None:
        """Note a joint state that cannot be used: the joints may have jumped."""
        for track in self.tracks:
            track.reset()

    def add_image(self, stamp_s: float, z: np.ndarray, camera: int = 0) -> None:
        """Take what a camera measured, (m,), and its stamp, s."""
        chain = self.estimator.chain
        late_s = chain.each[camera].webcam.late_s if isinstance(chain, PixelChains) else 0.0
        self._learn(camera, self.tracks[camera].add_image(stamp_s - late_s, z))

    def add_sliding_variable(self, stamp_s: float, sliding_m: np.ndarray) -> None:
        """Take the controller's sliding variable, m, (d,); the newest goes into coming steps."""
        if all_finite(sliding_m):
            self._sliding = (stamp_s, sliding_m)

    # --- outputs ---

    @property
    def problem(self) -> str:
        """Why there is no estimate yet; empty if there is one."""
        unseen = not self.kind.flat and self.tracks[0].newest is None
        name = self.kind.feature.name
        return self.estimator.problem or (f"no {name} yet" if unseen else "")

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Jacobian at the newest joints, rad, (n,): m/rad, (d, n)."""
        jacobian = self.at(joints_rad)
        if all_finite(jacobian):
            self._jacobian = jacobian
        return jacobian

    def at(self, joints_rad: np.ndarray) -> np.ndarray:
        """Jacobian at any joints, rad, (n,), with what is seen now: m/rad, (d, n)."""
        z = None
        if not self.kind.flat:
            z, newest = self.tracks[0].now(), self.tracks[0].newest
            if z is None and newest is not None:
                z = newest.z
        return self.estimator.jacobian(joints_rad, z)

    def status_values(self) -> dict[str, Any]:
        """Live key numbers of pairing and method."""
        timelines = [track.timeline for track in self.tracks]
        return {
            "steps_learned": self.steps,
            "images_not_paired": sum(timeline.dropped for timeline in timelines),
            "last_not_paired_because": next(
                (timeline.last_reason for timeline in timelines if timeline.last_reason), ""
            ),
            "position_noise_m": max(track.filter.noise_m for track in self.tracks),
            **self.estimator.status_values(),
        }

    # --- between ---

    def _learn(self, camera: int, images: list[Image]) -> None:
        if not (self.learns and self.estimator.learns):
            return
        estimator, track = self.estimator.each[camera], self.tracks[camera]
        for image in images:
            step = self._step(camera, image)
            estimator.observe(image, track.filter.noise_m)
            if step is not None:
                estimator.update(step)
                self.steps += 1

    def _step(self, camera: int, image: Image) -> MotionStep | None:
        """The step that an image of a camera completes, if it does."""
        anchor = self._anchors[camera]
        if (
            anchor is None
            or image.run != anchor.run
            or image.stamp_s - anchor.stamp_s > _MAX_STEP_S
        ):
            self._anchors[camera] = image
            return None
        d_joints = image.joints_rad - anchor.joints_rad
        if largest(d_joints) < _MIN_STEP_RAD:
            return None
        self._anchors[camera] = image
        sliding: np.ndarray | float = 0.0
        if self._sliding and abs(image.stamp_s - self._sliding[0]) <= FRESH_S:
            sliding = self._sliding[1][self.kind.rows[camera]]
        return MotionStep(
            stamp_s=image.stamp_s,
            dt_s=image.stamp_s - anchor.stamp_s,
            joints_rad=anchor.joints_rad + 0.5 * d_joints,
            d_joints_rad=d_joints,
            d_feature_m=image.seen_m - anchor.seen_m,
            z=image.z,
            sliding_variable=sliding,
        )
