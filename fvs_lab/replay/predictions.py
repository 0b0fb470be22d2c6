"""How well the recorded Jacobian predicted the ball: the paper's T1 and T2."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.pairing import StepPairing
from fvs_lab.replay.recording import Recording, Series
from fvs_tools.score import criteria

#: A Jacobian older than this predicts nothing, s.
_OLD_S = 0.3


@dataclass(frozen=True)
class Prediction:
    """Predictions of the recorded Jacobian, n steps.

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
    """Judge the Jacobian; None where the bag has none, or no motion.

    A step is predicted by the newest Jacobian at its middle, and never by one that may have learned
    from the image at its end. Jacobians have no stamps: joint states tell one clock from the other.
    """
    series = recording.series
    if not {"joints", "ball", "jacobian"} <= series.keys():
        return None
    jacobian, true = series["jacobian"], series.get("true_ball")
    joints, ball = series["joints"].by_time(), series["ball"].by_time()
    end_s, duration_s, d_joints_rad, motion_m = _steps(joints, ball)
    if true is not None:
        true = true.by_time()
        motion_m = np.stack(
            [
                np.interp(end_s, true.time_s, one, np.nan, np.nan)
                - np.interp(end_s - duration_s, true.time_s, one, np.nan, np.nan)
                for one in true.values.T
            ],
            axis=1,
        )
    if not len(end_s):
        return None
    middle_s = np.interp(end_s - 0.5 * duration_s, joints.time_s, joints.arrival_s)
    image_s = ball.arrival_s[np.searchsorted(ball.time_s, end_s)]
    wanted_s = np.minimum(middle_s, image_s)
    newest = np.searchsorted(jacobian.arrival_s, wanted_s) - 1
    usable = (newest >= 0) & (wanted_s - jacobian.arrival_s[newest] <= _OLD_S)
    usable &= np.isfinite(motion_m).all(axis=1)
    if not usable.any():
        return None
    rows = jacobian.values.reshape(len(jacobian), motion_m.shape[1], -1)[newest[usable]]
    motion_m = motion_m[usable]
    t1_m, t2_m = criteria(motion_m - np.einsum("nij,nj->ni", rows, d_joints_rad[usable]))
    lengths_m = np.linalg.norm(motion_m, axis=1)
    return Prediction(end_s[usable], lengths_m, t1_m, t2_m, true is not None)


def _steps(joints: Series, ball: Series) -> tuple[np.ndarray, ...]:
    """The steps that the estimator makes of the same messages in the same order, n of them.

    Returns
    -------
    tuple of ndarray
        End and duration, s, shape (n,), joint motion, rad, and ball motion, m, shape (n, k).
    """
    pairing = StepPairing()
    count = joints.values.shape[1] // 2
    width = 2 + count + ball.values.shape[1]
    rows = array("d")
    arrivals_s = np.concatenate([joints.arrival_s, ball.arrival_s])
    for index in np.argsort(arrivals_s, kind="stable"):
        image = index - len(joints)
        if image < 0:
            found = pairing.add_joints(joints.time_s[index], joints.values[index, :count])
        else:
            found = pairing.add_ball(ball.time_s[image], ball.values[image])
        for step in found:
            rows.extend((step.stamp_s, step.dt_s, *step.d_joints_rad, *step.d_ball_m))
    steps = np.frombuffer(rows).reshape(-1, width) if rows else np.empty((0, width))
    return steps[:, 0], steps[:, 1], steps[:, 2 : 2 + count], steps[:, 2 + count :]
