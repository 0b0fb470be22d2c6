"""Predicts the ball to now, and checks whether the image follows the arm.

The last image is carried forward by the joint motion since: ``x_now = x_image +
J (r_now - r_image)``. The product is summed over the joint states in between, ``sum J_k dr_k``:
within a latency of 0.1 s the ball's path curves by more than the camera's noise.

Measured motion is compared with predicted motion. From an anchor on, both paths are recorded at
every exposure: p, predicted by ``sum J dr``, and s, measured. One sum over both gives, at any speed
of the arm:

- the share of p that is measured, in any direction (the camera may have been turned): almost zero
  for a frozen image, or for a red object other than the ball;
- the error of the predicted motion: a wrong Jacobian, a moved camera;
- no verdict while the motion is too small for the noise of the images.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

from fvs_ros.timeline import MAX_LATENCY_S, History, Sample, Timeline
from fvs_ros.tracker import Image, Tracker
from fvs_ros.vectors import length

#: No verdict below this predicted motion, m: the arm moves this far before a frozen image shows.
_LEAST_M = 0.012
#: No verdict before the measured share is known to this standard deviation.
_DEVIATION = 0.12
#: No verdict before this time, s: a smaller stamp delay looks like a late start of the motion.
_LEAST_S = 0.25
#: Positions nearer than this to the first of their cell are averaged, m.
_CELL_M = _LEAST_M / 8.0
#: Largest number of cells.
_CELLS = 64


class Verdict(NamedTuple):
    """How seen and predicted motion agree."""

    predicted_m: float  #: predicted motion of the feature
    seen_share: float  #: measured share of it, in any direction
    #: Error of the prediction over the larger one of predicted and seen motion, rms: 0 is perfect,
    #: 1 no better than predicting rest, 2 the opposite.
    error_ratio: float
    time_s: float  #: within this time


@dataclass
class _Cell:
    """Images with nearly the same predicted position: sums of predicted and seen positions."""

    stamp_s: float
    anchor_m: np.ndarray
    images: int
    moved_m: np.ndarray
    seen_m: np.ndarray

    def add(self, moved_m: np.ndarray, seen_m: np.ndarray) -> None:
        self.images += 1
        self.moved_m = self.moved_m + moved_m
        self.seen_m = self.seen_m + seen_m


class Agreement:
    """Compares seen and predicted motion; ``verdict`` is None while the motion is too small."""

    def __init__(self) -> None:
        self._newest_s = -inf
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        self._cells: list[_Cell] = []
        self.verdict: Verdict | None = None

    def add(self, image: Image, noise_m: float) -> None:
        """Take an image, and the standard deviation of a coordinate of images, m."""
        stamp_s, seen_m, moved_m, _ = image
        if stamp_s <= self._newest_s:  # the clock stepped back: the cells remain valid
            for cell in self._cells:
                cell.stamp_s += stamp_s - self._newest_s
        self._newest_s = stamp_s
        if not self._cells or length(moved_m - self._cells[-1].anchor_m) > _CELL_M:
            self._cells.append(_Cell(stamp_s, moved_m, 1, moved_m, seen_m))
        else:
            self._cells[-1].add(moved_m, seen_m)
        del self._cells[:-_CELLS]
        verdict = self._judge(0, noise_m)
        while verdict is not None and (later := self._judge(1, noise_m)) is not None:
            self._cells.pop(0)
            verdict = later
        self.verdict = verdict

    def _judge(self, first: int, noise_m: float) -> Verdict | None:
        """The verdict of the cells from one on; None where they do not suffice for one."""
        cells = self._cells[first:]
        if len(cells) < 2 or self._newest_s - cells[0].stamp_s < _LEAST_S:
            return None
        images = np.array([float(cell.images) for cell in cells])
        moved = np.array([cell.moved_m for cell in cells]) / images[:, None]
        predicted_m = float(np.linalg.norm(moved - moved[-1], axis=1).max())
        if predicted_m < _LEAST_M:
            return None
        weights = images / images.sum()
        moved -= weights @ moved
        power = float(images @ np.square(moved).sum(axis=1))
        if noise_m**2 > _DEVIATION**2 * power:
            return None
        seen = np.array([cell.seen_m for cell in cells]) / images[:, None]
        seen -= weights @ seen
        share = float(np.linalg.norm((seen * images[:, None]).T @ moved, "nuc")) / power
        noise_m2 = seen.shape[1] * (len(cells) - 1) * noise_m**2
        off = max(0.0, float(images @ np.square(seen - moved).sum(axis=1)) - noise_m2)
        seen_power = float(images @ np.square(seen).sum(axis=1)) - noise_m2
        ratio = (off / max(power, seen_power)) ** 0.5
        return Verdict(predicted_m, share, ratio, self._newest_s - cells[0].stamp_s)


class BallPredictor:
    """Predicts the ball to now, and fuses images with joint motion.

    The history of the ball's motion ``sum J dr`` is as long as that of the joints, so that it
    covers each image's exposure. Between images the estimate follows this motion; each image
    corrects it (:class:`~fvs_ros.tracker.Tracker`). A clock jump resets the estimate.
    """

    def __init__(self) -> None:
        self.images = 0  #: number of images used so far
        self.tracker, self.agreement = Tracker(), Agreement()
        self._timeline = Timeline()
        self._moved = History()  # of the ball by the joints, m
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._timeline.reset()
        self._moved.clear()
        self.agreement.restart()
        self._forget_ball()

    def _forget_ball(self) -> None:
        self._jumps = self._timeline.clock_jumps
        self._stamp_s: float | None = None  # exposure that the estimate belongs to
        self.image_m: np.ndarray | None = None  #: the ball in the newest image, m, (m,)
        #: Age of the newest image against the newest joint state then, s.
        self.latency_s: float | None = None
        self.tracker.restart()

    @property
    def problem(self) -> str:
        """Why there is no prediction, in words; empty if there is one, or nothing to use."""
        newest_s, seen_s = self._timeline.joints.newest_stamp_s, self._timeline.seen_stamp_s
        if newest_s is None or seen_s is None:
            return ""
        age_s = newest_s - seen_s
        if abs(age_s) > MAX_LATENCY_S:
            side = "older" if age_s > 0.0 else "newer"
            lost = "is the ball in view? Else " if age_s > 0.0 else ""
            return (
                f"the newest ball_position is stamped {abs(age_s):.2f} s {side} than the newest "
                f"joint_states; {lost}check that both machines' clocks agree (NTP), and "
                "use_sim_time"
            )
        if self._stamp_s is None:
            return "no ball_position has joint states around its exposure time yet"
        return ""

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray, jacobian: np.ndarray) -> None:
        """Take a joint state, s and rad, (n,), and the newest Jacobian, m/rad, (m, n).

        The stamp is newer than the last, or of another clock.
        """
        before, moved = self._timeline.joints.newest, self._moved.newest
        if before is None or moved is None:
            moved = np.zeros(len(jacobian))
        else:
            moved = moved + jacobian @ (joints_rad - before)
        self._moved.add(stamp_s, moved)
        self._use(self._timeline.add_joints(stamp_s, joints_rad))

    def add_ball(self, stamp_s: float, position_m: np.ndarray) -> None:
        """Take a ball position, m, (m,), and its exposure on the joint states' clock, s."""
        self._use(self._timeline.add_ball(stamp_s, position_m))

    def _use(self, samples: list[Sample]) -> None:
        if self._timeline.clock_jumps != self._jumps:
            self._forget_ball()
        for stamp_s, _, ball, _ in samples:
            moved, newest_s = self._moved.at(stamp_s), self._timeline.joints.newest_stamp_s
            assert newest_s is not None
            assert moved is not None  # where the joints are known, this is
            self.latency_s = newest_s - stamp_s
            self.image_m, self._stamp_s = ball, stamp_s
            self.images += 1
            for image in self.tracker.add(Image(stamp_s, ball, moved)):
                self.agreement.add(image, self.tracker.noise_m)

    def predict(self) -> np.ndarray | None:
        """Predict the ball's position at the newest joint state, m, (m,).

        None where there is nothing to predict from (see ``problem``).
        """
        newest, moved = self._timeline.joints.newest_stamp_s, self._moved.newest
        estimate = self.tracker.estimate_m
        if newest is None or moved is None or self._stamp_s is None or estimate is None:
            return None
        if newest - self._stamp_s > MAX_LATENCY_S or self.problem:
            return None
        return estimate + moved - self.tracker.moved_m
