"""Where the ball is now: the last image carried forward by the joints' motion since.

``x_now = x_image + J (r_now - r_image)``, with the product summed over the joint states in
between, ``sum J_k dr_k``: over a latency of a tenth of a second the arm bends the straight line
by more than the camera's noise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from fvs_ros.agreement import Agreement
from fvs_ros.history import MAX_BACKSTEP_S, JointHistory
from fvs_ros.params import Parameters, parameter
from fvs_ros.tracker import Image, Tracker

#: Ball positions that may wait for the joint state after their exposure.
_MAX_WAITING = 32


@dataclass(frozen=True)
class PredictorConfig(Parameters):
    """Settings of the predictor."""

    predictor: bool = parameter(
        True, "Predict the ball from its exposure to now with the joints' motion.", live=True
    )
    max_latency_s: float = parameter(
        0.5, "No prediction over more than this, s.", 0.01, 1.9, live=True
    )


class BallPredictor:
    """Predicts the ball to now, and fuses images with joint motion.

    The ball's motion ``sum J dr`` is kept over time and interpolated at an image's exposure (an
    image waits for a later joint state if need be). Between images the estimate follows it; an
    image pulls it (:class:`~fvs_ros.tracker.Tracker`). Clock jumps start it anew.

    Parameters
    ----------
    config : PredictorConfig, optional
        Settings; may be exchanged at any time.
    """

    def __init__(self, config: PredictorConfig | None = None) -> None:
        self.config = config or PredictorConfig()
        self._images = 0
        self.tracker, self.agreement = Tracker(), Agreement()
        self._moved = JointHistory()  # of the ball by the joints, m, rather than of the joints
        self._waiting: deque[tuple[float, np.ndarray]] = deque(maxlen=_MAX_WAITING)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._moved.clear()
        self.agreement.restart()
        self._joints: np.ndarray | None = None
        self._forget_ball()

    def _forget_ball(self) -> None:
        self._waiting.clear()
        self._stamp_s: float | None = None  # exposure that the estimate belongs to
        self._seen_stamp_s: float | None = None  # newest exposure received
        self._raw: np.ndarray | None = None
        self._latency_s: float | None = None
        self.tracker.restart()

    @property
    def images(self) -> int:
        """Number of images heard of so far."""
        return self._images

    @property
    def latency_s(self) -> float | None:
        """Age of the newest usable image against the newest joint state, s."""
        return self._latency_s

    @property
    def problem(self) -> str:
        """Why there is no prediction, in words; empty if there is one, or nothing to use."""
        newest = self._moved.newest_stamp_s
        if newest is None or self._seen_stamp_s is None:
            return ""
        age_s = newest - self._seen_stamp_s
        if abs(age_s) > self.config.max_latency_s:
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
        """Tell a joint state.

        Parameters
        ----------
        stamp_s : float
            Its stamp, s, newer than the last or of another clock.
        joints_rad : ndarray, shape (n,)
            Positions, rad.
        jacobian : ndarray, shape (m, n)
            Newest estimate of the Jacobian, m/rad.
        """
        moved = self._moved.newest
        if moved is None or self._joints is None:
            self._moved.add(stamp_s, np.zeros(len(jacobian)))
        elif not self._moved.add(stamp_s, moved + jacobian @ (joints_rad - self._joints)):
            self._forget_ball()
        self._joints = np.array(joints_rad, dtype=float)
        while self._waiting and self._waiting[0][0] <= stamp_s:
            self._use(*self._waiting.popleft())

    def add_ball(self, stamp_s: float, position_m: np.ndarray) -> None:
        """Tell a ball position.

        Parameters
        ----------
        stamp_s : float
            Exposure time, s, on the clock of the joint states.
        position_m : ndarray, shape (m,)
            Position, m.
        """
        if self._seen_stamp_s is not None and stamp_s <= self._seen_stamp_s:
            if stamp_s >= self._seen_stamp_s - MAX_BACKSTEP_S:
                return
            self._forget_ball()
        self._seen_stamp_s = stamp_s
        newest = self._moved.newest_stamp_s
        if newest is not None and stamp_s <= newest:
            self._use(stamp_s, np.array(position_m, dtype=float))
        else:
            self._waiting.append((stamp_s, np.array(position_m, dtype=float)))

    def _use(self, stamp_s: float, position: np.ndarray) -> None:
        moved = self._moved.at(stamp_s)
        if moved is None:
            return
        newest = self._moved.newest_stamp_s
        assert newest is not None
        self._latency_s = newest - stamp_s
        if self._latency_s > self.config.max_latency_s:
            return  # the clocks differ
        self._raw = position
        self._stamp_s = stamp_s
        self._images += 1
        for image in self.tracker.add(Image(stamp_s, position, moved)):
            noise_m = self.tracker.noise_m
            self.agreement.add(image.stamp_s, image.seen_m, image.moved_m, noise_m)

    def predict(self) -> np.ndarray | None:
        """Predict the ball's position at the newest joint state.

        Returns
        -------
        ndarray, shape (m,), or None
            Position, m; None where there is nothing to predict from (see ``problem``).
        """
        newest, moved = self._moved.newest_stamp_s, self._moved.newest
        estimate = self.tracker.estimate_m
        if newest is None or moved is None or self._stamp_s is None or estimate is None:
            return None
        if newest - self._stamp_s > self.config.max_latency_s or self.problem:
            return None
        if not self.config.predictor:
            return None if self._raw is None else self._raw.copy()
        return estimate + moved - self.tracker.moved_m
