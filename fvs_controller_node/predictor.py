"""Where the ball is now: the last image carried forward by the joints' motion since.

``x_now = x_image + J (r_now - r_image)``, with the product summed over the joint states in
between, ``sum J_k dr_k``: over a latency of a tenth of a second the arm bends the straight line
by more than the camera's noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.agreement import Agreement
from fvs_ros.params import Parameters, parameter
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.tracker import Image, Tracker


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

    The ball's motion ``sum J dr`` takes the joints' place in the timeline, so that it is known at
    each image's exposure. Between images the estimate follows it; an image pulls it
    (:class:`~fvs_ros.tracker.Tracker`). Clock jumps start it anew.

    Parameters
    ----------
    config : PredictorConfig, optional
        Settings.

    Attributes
    ----------
    images : int
        Number of images used so far.
    latency_s : float or None
        Age of the newest used image against the newest joint state then, s.
    """

    def __init__(self, config: PredictorConfig | None = None) -> None:
        self.config = config or PredictorConfig()
        self.images = 0
        self.tracker, self.agreement = Tracker(), Agreement()
        self._timeline = Timeline(self.config.max_latency_s)
        self.reset()

    def configure(self, config: PredictorConfig) -> None:
        """Change settings while running."""
        self.config = config
        self._timeline.max_latency_s = config.max_latency_s

    def reset(self) -> None:
        """Forget everything."""
        self._timeline.reset()
        self.agreement.restart()
        self._joints: np.ndarray | None = None
        self._forget_ball()

    def _forget_ball(self) -> None:
        self._jumps = self._timeline.clock_jumps
        self._stamp_s: float | None = None  # exposure that the estimate belongs to
        self._raw: np.ndarray | None = None
        self.latency_s: float | None = None
        self.tracker.restart()

    @property
    def problem(self) -> str:
        """Why there is no prediction, in words; empty if there is one, or nothing to use."""
        newest_s, seen_s = self._timeline.newest_stamp_s, self._timeline.seen_stamp_s
        if newest_s is None or seen_s is None:
            return ""
        age_s = newest_s - seen_s
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
        moved = self._timeline.newest
        if moved is None or self._joints is None:
            moved = np.zeros(len(jacobian))
        else:
            moved = moved + jacobian @ (joints_rad - self._joints)
        self._joints = np.array(joints_rad, dtype=float)
        self._use(self._timeline.add_joints(stamp_s, moved))

    def add_ball(self, stamp_s: float, position_m: np.ndarray) -> None:
        """Tell a ball position.

        Parameters
        ----------
        stamp_s : float
            Exposure time, s, on the clock of the joint states.
        position_m : ndarray, shape (m,)
            Position, m.
        """
        self._use(self._timeline.add_ball(stamp_s, position_m))

    def _use(self, samples: list[Sample]) -> None:
        if self._timeline.clock_jumps != self._jumps:
            self._forget_ball()
        for stamp_s, moved, ball, _ in samples:
            assert self._timeline.newest_stamp_s is not None
            self.latency_s = self._timeline.newest_stamp_s - stamp_s
            self._raw, self._stamp_s = ball, stamp_s
            self.images += 1
            for image in self.tracker.add(Image(stamp_s, ball, moved)):
                noise_m = self.tracker.noise_m
                self.agreement.add(image.stamp_s, image.seen_m, image.moved_m, noise_m)

    def predict(self) -> np.ndarray | None:
        """Predict the ball's position at the newest joint state.

        Returns
        -------
        ndarray, shape (m,), or None
            Position, m; None where there is nothing to predict from (see ``problem``).
        """
        newest, moved = self._timeline.newest_stamp_s, self._timeline.newest
        estimate = self.tracker.estimate_m
        if newest is None or moved is None or self._stamp_s is None or estimate is None:
            return None
        if newest - self._stamp_s > self.config.max_latency_s or self.problem:
            return None
        if not self.config.predictor:
            return None if self._raw is None else self._raw.copy()
        return estimate + moved - self.tracker.moved_m
