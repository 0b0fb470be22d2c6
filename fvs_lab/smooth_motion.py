"""Recordings of the simulated arm in smooth motion, and the paper's criteria T1 and T2 on them.

A recording is made once, and all estimators get it. An estimator is always judged on a step
before it learns from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.steps import StepPairing
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, relative_errors, simulation_of
from fvs_ros.filter import Image
from fvs_ros.track import Track as ImageTrack
from fvs_tools.score import criteria

#: Speed of the fastest joint, rad/s.
SPEED_RAD_S = 0.4
#: Time from the start of the motion until it is scored, s.
PRELUDE_S = 5.0


@dataclass(frozen=True)
class Recording:
    """The n steps that all estimators get, with the simulator's ground truth."""

    steps: tuple[MotionStep, ...]
    #: End of each step since the scored motion began, s; in the prelude not above 0. Shape (n,).
    time_s: np.ndarray
    #: True ball motion of each step, camera frame, m, shape (n, m).
    true_d_ball_m: np.ndarray
    #: True Jacobian at each step's ``joints_rad``, m/rad, shape (n, m, joints).
    true_jacobian: np.ndarray
    #: Share of the images in which the ball was found.
    visible_share: float
    #: Error of the ball positions, rms of the distance, m.
    position_error_m: float


def record(seed: int, conditions: Conditions, duration_s: float) -> Recording:
    """Move the simulated arm, and record measurements and ground truth.

    The seed determines motion and noise. The motion begins some time before the part of this
    length, s, that is scored.
    """
    simulation = simulation_of(conditions)
    config = MotionConfig(
        duration_s=3600.0,  # its end, which is slow, is never reached
        joint_range_rad=tuple(0.9 * BOX_RAD),
        max_joint_velocity_rad_s=SPEED_RAD_S,
    )
    motion = RandomMotion(HOME_RAD, config, np.random.default_rng([seed, 1]))
    simulation.reset(HOME_RAD, seed)
    pairing, track, images = StepPairing(), ImageTrack(simulation.kind), list[Image]()
    period_s = 1.0 / simulation.config.joint_state_rate_hz
    joints = simulation.joints_rad
    truth_m: dict[int, np.ndarray] = {}
    squared_errors_m2: list[float] = []
    for _ in range(round((PRELUDE_S + duration_s) / period_s)):
        simulation.command(motion.command(simulation.time_s, joints))
        out = simulation.advance()
        joints = out.joints_rad
        for seen in out.observations:
            truth_m[_microseconds(seen.stamp_s)] = seen.true_position_m
            if seen.z is not None:
                error_m = seen.z - seen.true_position_m
                squared_errors_m2.append(float(error_m @ error_m))
                images += track.add_image(seen.stamp_s, seen.z)
        images += track.add_joints(out.time_s, joints, None)
    steps = [step for step in map(pairing.step, images) if step is not None]
    ends_m, starts_m = (
        np.array([truth_m[_microseconds(getattr(step, name))] for step in steps])
        for name in ("stamp_s", "start_stamp_s")
    )
    return Recording(
        steps=tuple(steps),
        time_s=np.array([step.stamp_s for step in steps]) - PRELUDE_S,
        true_d_ball_m=ends_m - starts_m,
        true_jacobian=np.array([simulation.true_jacobian(step.joints_rad) for step in steps]),
        visible_share=len(squared_errors_m2) / len(truth_m),
        position_error_m=float(np.sqrt(np.mean(squared_errors_m2))),
    )


def _microseconds(stamp_s: float) -> int:
    """A stamp as a key that survives the rounding of sums."""
    return round(1e6 * stamp_s)


@dataclass(frozen=True)
class Track:
    """How well one estimator did along the scored motion: n steps, shape (n,) each."""

    #: End of each step since the scored motion began, s, and its true ball motion's length, m.
    time_s: np.ndarray
    motion_m: np.ndarray
    #: T1 = |dx - J dr|, eq (40): dx true, J before it learned from the step, m.
    t1_m: np.ndarray
    #: T2 = |x - x_hat|, eqs (41) and (42): x_hat is summed up of the predictions J dr, m.
    t2_m: np.ndarray
    #: |J - J_true| / |J_true|, Frobenius norms.
    jacobian_error: np.ndarray
    #: J, m/rad, shape (n, m, joints).
    jacobian: np.ndarray

    def summary(self) -> dict[str, float]:
        """The run in a few numbers, by name."""
        late = self.time_s > 0.5 * self.time_s[-1]
        return {
            "t1_m": float(self.t1_m.mean()),
            "t1_late_m": float(self.t1_m[late].mean()),
            "t2_max_m": float(self.t2_m.max()),
            "jacobian_error": float(self.jacobian_error.mean()),
        }

    def means(self, duration_s: float, bin_s: float) -> dict[str, np.ndarray]:
        """T1 and T2 as series of means over intervals; not a number where one is empty."""
        from scipy.stats import binned_statistic

        edges_s = np.linspace(0.0, duration_s, round(duration_s / bin_s) + 1)
        t1_m, t2_m = binned_statistic(self.time_s, [self.t1_m, self.t2_m], bins=edges_s).statistic
        return {"time_s": 0.5 * (edges_s[1:] + edges_s[:-1]), "t1_m": t1_m, "t2_m": t2_m}


def judge(estimator: Estimator, recording: Recording, hears_prelude: bool) -> Track:
    """Let a fresh estimator predict, and then learn from, each step of a recording.

    ``hears_prelude``: whether it also learns from the steps before the scored motion.
    """
    scored = recording.time_s > 0.0
    jacobians = []
    for step, counts in zip(recording.steps, scored, strict=True):
        if counts:
            jacobians.append(estimator.jacobian(step.joints_rad, step.z))
        if estimator.learns and (counts or hears_prelude):
            estimator.update(step)
    jacobian, true_m = np.array(jacobians), recording.true_d_ball_m[scored]
    moved_rad = np.array([step.d_joints_rad for step in recording.steps])[scored]
    t1_m, t2_m = criteria(true_m - np.einsum("nij,nj->ni", jacobian, moved_rad))
    return Track(
        time_s=recording.time_s[scored],
        motion_m=np.linalg.norm(true_m, axis=1),
        t1_m=t1_m,
        t2_m=t2_m,
        jacobian_error=relative_errors(jacobian, recording.true_jacobian[scored]),
        jacobian=jacobian,
    )
