"""Follows what is measured: the joints at each exposure, the one filter, the prediction to now.

The measurement is predicted to now by the joint motion since its exposure, summed over the joint
states in between, ``sum J_k dr_k``: within a latency of 0.1 s the path curves by more than the
camera's noise. On a curved kind of feature the path is a sum of tangent vectors, so that the filter
(:mod:`fvs_ros.filter`) works on plain vectors.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.filter import Image, PathFilter
from fvs_ros.kinds import Kind
from fvs_ros.timeline import MAX_LATENCY_S, Sample, Timeline


class Track:
    """Pairs images with joints, judges them, and predicts what they measure.

    That is of a kind: m numbers that move in d ways.
    """

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.filter = PathFilter()  #: its estimate, noise and deviation
        self.timeline = Timeline()  #: the pairing, with its counters
        self.images = 0  #: how many were paired so far
        self.reset()

    def reset(self) -> None:
        """Forget joints and images; the learned noise stays."""
        self.timeline.reset()
        self._forget_images()

    def _forget_images(self) -> None:
        self._clock_jumps = self.timeline.clock_jumps
        self.filter.restart()
        self.newest: Image | None = None  #: that was paired, accepted or not
        self.latency_s: float | None = None  #: its age against the newest joint state then, s
        self._accepted: Image | None = None  # the newest that is no outlier

    def add_joints(
        self, stamp_s: float, joints_rad: np.ndarray, jacobian: np.ndarray | None
    ) -> list[Image]:
        """Take a joint state, s and rad, (n,), no jump, and the newest Jacobian, m/rad, (d, n).

        Returns the images that waited for it and are accepted; without a Jacobian all are.
        """
        before, n = self.timeline.joints.newest, len(joints_rad)
        moved_m = np.zeros(self.kind.size) if before is None else before[n:]
        if before is not None and jacobian is not None:
            moved_m = moved_m + jacobian.dot(joints_rad - before[:n])
        if jacobian is None:
            self.filter.restart()  # nothing to judge images by
        both = np.concatenate([joints_rad, moved_m])
        return self._accept(self.timeline.add_joints(stamp_s, both))

    def add_image(self, stamp_s: float, z: np.ndarray) -> list[Image]:
        """Take a measurement, (m,), and its exposure, s; returns the images accepted now."""
        return self._accept(self.timeline.add_image(stamp_s, z))

    def _accept(self, samples: list[Sample]) -> list[Image]:
        if self.timeline.clock_jumps != self._clock_jumps:
            self._forget_images()
        return [image for sample in samples for image in self._judge(sample)]

    def _judge(self, sample: Sample) -> list[Image]:
        stamp_s, both, z, run = sample
        joints_rad, moved_m = both[: -self.kind.size], both[-self.kind.size :]
        last, newest_s = self._accepted, self.timeline.joints.newest_stamp_s
        assert newest_s is not None
        seen_m = moved_m if last is None else last.seen_m + self.kind.minus(z, last.z)
        self.newest = Image(stamp_s, joints_rad, z, seen_m, moved_m, run)
        self.latency_s = newest_s - stamp_s
        self.images += 1
        accepted = self.filter.add(self.newest)
        # Of a jump, no motion step is made.
        accepted = [image._replace(run=run + self.filter.jumps) for image in accepted]
        if accepted:
            self._accepted = accepted[-1]
        return accepted

    @property
    def problem(self) -> str:
        """Why there is no prediction, in words; empty if there is one, or nothing to use."""
        newest_s, seen_s = self.timeline.joints.newest_stamp_s, self.timeline.seen_stamp_s
        name = self.kind.feature.name
        if newest_s is None or seen_s is None:
            return ""
        age_s = newest_s - seen_s
        if abs(age_s) > MAX_LATENCY_S:
            side = "older" if age_s > 0.0 else "newer"
            lost = "is it in view, or do images arrive late? Else " if age_s > 0.0 else ""
            return (
                f"the newest {name} is stamped {abs(age_s):.2f} s {side} than the newest "
                f"joint_states; {lost}check that both machines' clocks agree (NTP), and "
                "use_sim_time"
            )
        if self.newest is None:
            return f"no {name} has joint states around its exposure time yet"
        return ""

    def now(self, drift_m: np.ndarray | None = None) -> np.ndarray | None:
        """The measurement, predicted to the newest joint state, (m,).

        ``drift_m``, (d,), is where what moves by itself is on its path, ``seen_m - moved_m``, m, if
        that is known. None where there is nothing to predict from (see ``problem``).
        """
        newest_s, last = self.timeline.joints.newest_stamp_s, self.timeline.joints.newest
        image, accepted, x = self.newest, self._accepted, self.filter.x
        if newest_s is None or last is None or image is None or accepted is None or x is None:
            return None
        if newest_s - image.stamp_s > MAX_LATENCY_S or self.problem:
            return None
        moved_m = last[-self.kind.size :]
        x = x + moved_m - self.filter.moved_m if drift_m is None else drift_m + moved_m
        return self.kind.retract(accepted.z, x - accepted.seen_m)
