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

from math import inf
from typing import NamedTuple

import numpy as np

from fvs_controller_node.redundancy import singular_values
from fvs_ros.feature import Feature
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


class Agreement:
    """Compares seen and predicted motion; ``verdict`` is None while the motion is too small."""

    def __init__(self) -> None:
        self._newest_s = -inf
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        #: Of images with nearly the same predicted position: the first one's stamp, their number,
        #: and the sums of predicted and seen positions, (2 + 2 m,) each.
        self._cells = np.zeros((0, 2))
        self._anchor_m = np.zeros(0)  # predicted position that the newest cell began with
        self.verdict: Verdict | None = None

    def add(self, image: Image, noise_m: float) -> None:
        """Take an image, and the standard deviation of a coordinate of images, m."""
        stamp_s, seen_m, moved_m, _ = image
        if stamp_s <= self._newest_s:  # the clock stepped back: the cells remain valid
            self._cells[:, 0] += stamp_s - self._newest_s
        self._newest_s = stamp_s
        one = np.concatenate([(stamp_s, 1.0), moved_m, seen_m])
        if len(self._cells) and length(moved_m - self._anchor_m) <= _CELL_M:
            self._cells[-1, 1:] += one[1:]
        else:
            self._anchor_m, first = moved_m, len(self._cells) == 0
            self._cells = one[None] if first else np.vstack([self._cells[1 - _CELLS :], one])
        self.verdict = self._judge(noise_m)

    def _judge(self, noise_m: float) -> Verdict | None:
        """The verdict of the newest cells that suffice for one, which stay; None without any."""
        cells = self._cells
        stamps_s, images = cells[:, 0].tolist(), cells[:, 1]
        moved, seen = np.hsplit(cells[:, 2:] / images[:, None], 2)
        verdict, first = None, 0
        while len(cells) - first > 1:
            time_s, some = self._newest_s - stamps_s[first], slice(first, None)
            later = _verdict(images[some], moved[some], seen[some], noise_m, time_s)
            if later is None:
                break
            verdict, first = later, first + 1
        self._cells = cells[max(0, first - 1) :]
        return verdict


def _verdict(
    images: np.ndarray, moved: np.ndarray, seen: np.ndarray, noise_m: float, time_s: float
) -> Verdict | None:
    """The verdict on k cells: images, (k,), predicted and seen positions, (k, m), m.

    None where they do not suffice.
    """
    if time_s < _LEAST_S:
        return None
    predicted_m = float(np.square(moved - moved[-1]).sum(axis=1).max()) ** 0.5
    if predicted_m < _LEAST_M:
        return None
    weights = images / images.sum()
    moved = moved - weights @ moved
    power = float(images @ np.square(moved).sum(axis=1))
    if noise_m**2 > _DEVIATION**2 * power:
        return None
    seen = seen - weights @ seen
    share = float(singular_values((seen * images[:, None]).T @ moved).sum()) / power
    noise_m2 = seen.shape[1] * (len(images) - 1) * noise_m**2
    off = max(0.0, float(images @ np.square(seen - moved).sum(axis=1)) - noise_m2)
    seen_power = float(images @ np.square(seen).sum(axis=1)) - noise_m2
    return Verdict(predicted_m, share, (off / max(power, seen_power)) ** 0.5, time_s)


class FeaturePredictor:
    """Predicts the ball to now, and fuses images with joint motion.

    The history of the ball's motion ``sum J dr`` is as long as that of the joints, so that it
    covers each image's exposure. Between images the estimate follows this motion; each image
    corrects it (:class:`~fvs_ros.tracker.Tracker`). A clock jump resets the estimate.
    """

    def __init__(self, feature: Feature | None = None) -> None:
        self._feature = feature or Feature()
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
        self._unjudged: list[Image] = []
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
            lost = "is it in view? Else " if age_s > 0.0 else ""
            return (
                f"the newest {self._feature.seen.name} is stamped {abs(age_s):.2f} s {side} than "
                f"the newest joint_states; {lost}check that both machines' clocks agree (NTP), and "
                "use_sim_time"
            )
        if self._stamp_s is None:
            return f"no {self._feature.seen.name} has joint states around its exposure time yet"
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
        # Images are judged one joint state later: no tick has all of an image's work.
        for image in self._unjudged:
            self.agreement.add(image, self.tracker.noise_m)
        self._unjudged.clear()
        self._use(self._timeline.add_joints(stamp_s, joints_rad))

    def add_feature(self, stamp_s: float, position_m: np.ndarray) -> None:
        """Take a ball position, m, (m,), and its exposure on the joint states' clock, s."""
        self._use(self._timeline.add_feature(stamp_s, position_m))

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
            self._unjudged += self.tracker.add(Image(stamp_s, ball, moved))

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
        return self._feature.nearest(estimate + moved - self.tracker.moved_m)
