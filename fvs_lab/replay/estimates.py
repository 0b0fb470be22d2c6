"""How well the recorded Jacobian predicted the ball: the paper's T1 and T2.

As in the laboratory (``experiments/estimators_recordings.py``): a step is the motion between two
images, and is predicted with the Jacobian that came before the step's end, so that it has not
learned from it. Steps are made by stamps, and Jacobians, which have none, come by the recorder's
clock; joint states have both, and so tell one from the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.pairing import StepPairing
from fvs_lab.replay.data import Recording, Series
from fvs_ros.joints import N_JOINTS
from fvs_tools.score import criteria

#: The true ball is interpolated between samples no further apart than this, s.
_TRUE_GAP_S = 0.05
#: A Jacobian older than this predicts nothing, s.
_OLD_S = 0.3


@dataclass(frozen=True)
class Prediction:
    """The recorded Jacobian's predictions, n steps.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        End of each step, s.
    motion_m : ndarray, shape (n,)
        Length of the ball's motion, m.
    t1_m, t2_m : ndarray, shape (n,)
        The paper's criteria, eqs (40) to (42), m.
    true : bool
        Whether the motion is the true one; else it is measured, with its noise.
    """

    time_s: np.ndarray
    motion_m: np.ndarray
    t1_m: np.ndarray
    t2_m: np.ndarray
    true: bool

    @property
    def share(self) -> float:
        """Sum of T1 over that of the motion."""
        return float(self.t1_m.sum() / self.motion_m.sum())


def prediction(recording: Recording) -> Prediction | None:
    """Judge the Jacobian; None where the bag has none, or no motion."""
    series = recording.series
    if not {"joints", "ball", "jacobian"} <= series.keys():
        return None
    joints, ball, jacobian = series["joints"], series["ball"], series["jacobian"]
    true = series.get("true_ball")
    joints_s, joints_came_s = _by_stamp(joints)
    images_s, images_came_s = _by_stamp(ball)
    rows = []
    for step in _steps(joints, ball):
        motion_m = _motion_m(step, true)
        # At the middle of the step, as the joints that it is to hold for; but never one that may
        # have learned from the image at its end.
        middle_s = float(np.interp(step.stamp_s - 0.5 * step.dt_s, joints_s, joints_came_s))
        image_s = float(images_came_s[np.searchsorted(images_s, step.stamp_s)])
        wanted_s = min(middle_s, image_s)
        index = int(np.searchsorted(jacobian.arrival_s, wanted_s, side="left")) - 1
        if motion_m is None or index < 0 or wanted_s - jacobian.arrival_s[index] > _OLD_S:
            continue
        predicted_m = jacobian.values[index].reshape(3, N_JOINTS) @ step.d_joints_rad
        rows.append((step.stamp_s, motion_m, motion_m - predicted_m))
    if not rows:
        return None
    time_s, motions_m, wrong_m = (np.array(one) for one in zip(*rows, strict=True))
    t1_m, t2_m = criteria(wrong_m)
    return Prediction(time_s, np.linalg.norm(motions_m, axis=1), t1_m, t2_m, true is not None)


def _by_stamp(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Stamps in order, and when their messages came, s."""
    known = np.flatnonzero(np.isfinite(series.stamp_s))
    order = known[np.argsort(series.stamp_s[known], kind="stable")]
    return series.stamp_s[order], series.arrival_s[order]


def _steps(joints: Series, ball: Series) -> list[MotionStep]:
    """The steps that the estimator makes of the same messages in the same order."""
    pairing = StepPairing()
    messages = [
        (arrival_s, stamp_s, values, take)
        for series, take, width in (
            (joints, pairing.add_joints, N_JOINTS),
            (ball, pairing.add_ball, 3),
        )
        for arrival_s, stamp_s, values in zip(
            series.arrival_s, series.stamp_s, series.values[:, :width], strict=True
        )
        if np.isfinite(stamp_s)
    ]
    found: list[MotionStep] = []
    for _, stamp_s, values, take in sorted(messages, key=lambda message: message[0]):
        found += take(stamp_s, values)
    return found


def _motion_m(step: MotionStep, true: Series | None) -> np.ndarray | None:
    """Ball motion of a step: the true one if it is known, None where its record has a gap."""
    if true is None:
        return step.d_ball_m
    start_m, end_m = (_at(true, stamp_s) for stamp_s in (step.start_stamp_s, step.stamp_s))
    return None if start_m is None or end_m is None else end_m - start_m


def _at(true: Series, stamp_s: float) -> np.ndarray | None:
    after = int(np.searchsorted(true.stamp_s, stamp_s, side="left"))
    if not 0 < after < len(true):
        return None
    t0, t1 = true.stamp_s[after - 1], true.stamp_s[after]
    if t1 - t0 > _TRUE_GAP_S:
        return None
    share = (stamp_s - t0) / (t1 - t0)
    return (1.0 - share) * true.values[after - 1] + share * true.values[after]
