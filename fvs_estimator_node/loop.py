"""The whole estimator without ROS: pairing, tracker and method, joined once.

The node hands messages in and publishes what the estimator says; the laboratory uses the same
object.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.pairing import StepPairing
from fvs_estimator_node.stamp_watch import StampWatch
from fvs_ros.chain import SerialChain
from fvs_ros.timeline import Sample
from fvs_ros.tracker import Image, Tracker

#: With images that are stamped by more too late or too early, no loop comes to rest, s.
_MOST_LATE_S = 0.08
#: This many of the last ball positions are paired anew once their stamps are known to be wrong.
_LAST = 16


class EstimationLoop:
    """Joint states and ball positions in; Jacobian, chain and status out.

    An outlier teaches nothing, as it does not move the controller. Stamps that are found to be
    late or early are corrected before anything is paired.

    Parameters
    ----------
    estimator : Estimator
        Learns and is asked.
    pairing : StepPairing, optional
        Makes steps of the messages.

    Attributes
    ----------
    learns : bool
        Off, the estimator learns nothing.
    steps : int
        Number of steps learned from.
    late_s : float
        How late the ball positions' stamps are, s; negative for early ones.
    """

    def __init__(self, estimator: Estimator, pairing: StepPairing | None = None) -> None:
        self.estimator = estimator
        self.pairing = pairing if pairing is not None else StepPairing()
        self.learns = True
        self._tracker = Tracker()
        self._moved_m = np.zeros(0)  # of the ball by the joints, up to the last sample
        self._way_m = np.zeros(3)  # the same as if no camera had ever been turned
        self._balls: deque[tuple[float, np.ndarray]] = deque(maxlen=_LAST)  # as they came
        self._forget()

    def _forget(self) -> None:
        self._last: Sample | None = None
        self.steps = 0
        self._stamps, self.late_s = StampWatch(), 0.0
        self._balls.clear()

    def reset(self) -> None:
        """Forget what was learned online, and all inputs."""
        self.estimator.reset()
        self.pairing.reset()
        self._forget()

    # --- inputs ---

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> bool:
        """Take a joint state, s and rad, (n,); whether the estimator learned from it."""
        return self._learn(self.pairing.matcher.add_joints(stamp_s, joints_rad))

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> bool:
        """Take a ball position, exposure in s and m, (m,); whether the estimator learned."""
        self._balls.append((stamp_s, ball_m))
        return self._learn(self.pairing.matcher.add_ball(stamp_s - self.late_s, ball_m))

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable, s and m, (m,)."""
        self.pairing.add_sliding_variable(stamp_s, sliding_variable)

    # --- outputs ---

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The present estimate at joints, rad, (n,): m/rad, (m, n)."""
        return self.estimator.jacobian(joints_rad)

    @property
    def chain(self) -> SerialChain | None:
        """The serial chain as the camera sees it now, if the method has one."""
        return self.estimator.chain

    @property
    def remark(self) -> str:
        """What does not fit although there is an estimate; empty if all is well."""
        if not self.late_s:
            return self.estimator.remark
        late_s, which = abs(self.late_s), "late" if self.late_s > 0.0 else "early"
        return (
            f"image stamps are too {which} by about {late_s:.2f} s; add {self.late_s:.2f} to the "
            "detector's stamp_delay_s or set the clocks, then call ~/reset"
        )

    @property
    def problem(self) -> str:
        """Why the arm must not move on the estimate; empty if it may."""
        return self.remark if abs(self.late_s) > _MOST_LATE_S else self.estimator.problem

    def status_values(self) -> dict[str, Any]:
        """Live key numbers of pairing and method."""
        return {
            "steps_learned": self.steps,
            "ball_positions_not_paired": self.pairing.matcher.dropped,
            "last_not_paired_because": self.pairing.matcher.last_reason,
            "images_late_s": self.late_s,
            **self.estimator.status_values(),
        }

    # --- between ---

    def _learn(self, samples: list[Sample]) -> bool:
        believed = [one for sample in samples for one in self._believed(sample)]
        learns = self.learns and self.estimator.learns and bool(believed)
        for sample in believed:
            step = self.pairing.step(sample)
            if not learns:
                continue
            self.estimator.observe(sample.joints_rad, sample.ball_m)
            if step is not None:
                self.estimator.update(step)
                self.steps += 1
        return learns

    def _correct_stamps(self, late_s: float) -> None:
        """Pair the last ball positions anew: what was learned came from wrong pairs."""
        self.late_s += late_s
        self._stamps = StampWatch()
        self.estimator.reset()
        self.pairing.matcher.forget_balls()
        for stamp_s, ball_m in list(self._balls):
            self._learn(self.pairing.matcher.add_ball(stamp_s - self.late_s, ball_m))

    def _believed(self, sample: Sample) -> list[Sample]:
        """The samples that are known now to be no outliers, oldest first."""
        last, self._last = self._last, sample
        if self.estimator.problem:
            self._last = None  # no prediction to judge by
            return [sample]
        moved_m = np.zeros_like(sample.ball_m)
        if last is None or last.run != sample.run:
            self._stamps = StampWatch()
        if last is None:
            self._tracker.restart()
        else:
            d_joints = sample.joints_rad - last.joints_rad
            step_m = self.estimator.jacobian(last.joints_rad + 0.5 * d_joints) @ d_joints
            moved_m = self._moved_m + step_m
            rotation = self.estimator.camera_rotation
            self._way_m = self._way_m + rotation.T @ step_m
        if not np.all(np.isfinite(moved_m)):
            self._last = None
            return [sample]
        self._moved_m = moved_m
        images = self._tracker.add(Image(sample.stamp_s, sample.ball_m, moved_m, sample))
        if last is not None:
            late_s = self._stamps.add(sample.stamp_s, sample.ball_m, self._way_m, rotation)
            if late_s:
                self._correct_stamps(late_s)
                return []
        return [image.source for image in images]
