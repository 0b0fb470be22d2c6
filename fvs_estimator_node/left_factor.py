"""The networks behind a camera that was moved: ``J = A J_rbf(r)`` with a 3x3 left factor A.

Turning the camera turns every column of the Jacobian alike, so that three numbers (a rotation) or
nine (any matrix) are all there is to learn, and a few steps teach them for the whole workspace,
where the update law (17) learns along the path only. With ``u = J_rbf dr`` of each step,

    C = sum dx u',  G = sum u u',  A = nearest rotation to C,  or  A = C G^-1.

Old steps fade with the way that the ball has gone since, not with time: near the target, where
steps are small and noisy, little is learned and little forgotten. Steps along one line need no
small noise: in their sum the positions in between cancel. A rotation is believed as far as noise
would not feign it: a turn about the very line that the ball goes along is told by its few
millimetres to the side. Where the camera was bumped, old steps say nothing any more: a step far too
long tells, or the next few that fit another rotation (:mod:`fvs_estimator_node.turn_watch`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.camera_doubts import CameraDoubts, CameraLearner
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfModel
from fvs_estimator_node.rotations import nearest_rotation, rotation_angle_rad
from fvs_estimator_node.turn_watch import TurnWatch
from fvs_ros.params import Parameter
from fvs_ros.vectors import length

ROTATION, MATRIX = "rotation", "matrix"
KINDS = (ROTATION, MATRIX)

_IDENTITY = np.eye(3)
#: A joint that has moved less than this between two images stands, rad.
_STILL_RAD = 2e-4
#: A step that is off by less than so many deviations is noise, however long.
_BUMP_DEVIATIONS = 6.0
#: Up to this standard deviation of one coordinate of a step no more is put back, m.
_KEPT_DEVIATION_M = 0.0014


@dataclass(frozen=True)
class LeftFactorConfig:
    """Settings of the left factor.

    Parameters
    ----------
    kind : str
        ``rotation``: three numbers, what moving a camera does; ``matrix``: nine.
    memory_m : float
        Way of the ball after which a step's weight has decayed by 63 %, m.
    trust_m : float
        The start (no motion of the camera) counts like a step of this length each way, m.
    bumped_trust_m : float
        The same for the factor so far after a bump, m.
    bump_m : float
        A step that is off by more, and by six standard deviations, is the camera's own motion: not
        learned from, m.
    min_motion_rad : float
        No learning from steps in which no joint moved further than this, rad.
    """

    kind: str = ROTATION
    memory_m: float = 0.3
    trust_m: float = 0.005
    bumped_trust_m: float = 0.005
    bump_m: float = 0.04
    min_motion_rad: float = 1e-3

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"unknown left factor {self.kind!r}; known are {', '.join(KINDS)}")
        for name in ("memory_m", "trust_m", "bumped_trust_m", "bump_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        if not self.min_motion_rad >= 0.0:
            raise ValueError(f"min_motion_rad must not be negative, got {self.min_motion_rad}")


_DEFAULT = LeftFactorConfig()

#: Parameters of the method ``rbf_left`` as a node declares them.
LEFT_FACTOR_PARAMETERS = (
    Parameter(
        "rbf_left.kind",
        _DEFAULT.kind,
        "What the left factor may be: a rotation, as of a moved camera, or any matrix.",
        choices=KINDS,
    ),
    Parameter(
        "rbf_left.memory_m",
        _DEFAULT.memory_m,
        "Way of the ball after which a step's weight has decayed by 63 %, m.",
        1e-3,
        1e3,
    ),
    Parameter(
        "rbf_left.trust_m",
        _DEFAULT.trust_m,
        "The networks as trained count like a step of this length each way, m.",
        1e-4,
        10.0,
    ),
    Parameter(
        "rbf_left.bumped_trust_m",
        _DEFAULT.bumped_trust_m,
        "The same for what was learned before a bump of the camera, m.",
        1e-4,
        10.0,
    ),
    Parameter(
        "rbf_left.bump_m",
        _DEFAULT.bump_m,
        "A step that is off by more was a motion of the camera, m.",
        1e-3,
        1.0,
    ),
    Parameter(
        "rbf_left.min_motion_rad",
        _DEFAULT.min_motion_rad,
        "No learning from steps with less joint motion than this, rad.",
        0.0,
        1.0,
    ),
)


def left_factor_config(values: Mapping[str, Any]) -> LeftFactorConfig:
    """Configuration from parameter values (``rbf_left.kind`` and so on)."""
    names = {field.name for field in fields(LeftFactorConfig)}
    return LeftFactorConfig(
        **{name: values[f"rbf_left.{name}"] for name in names if f"rbf_left.{name}" in values}
    )


class LeftFactorEstimator(CameraLearner, FrozenRbfEstimator):
    """Frozen networks times a learned 3x3 factor.

    Parameters
    ----------
    model : RbfModel
        The trained networks.
    config : LeftFactorConfig, optional
        Settings.
    """

    learns = True

    def __init__(self, model: RbfModel, config: LeftFactorConfig | None = None) -> None:
        super().__init__(model)
        self._config = config if config is not None else LeftFactorConfig()
        self.reset()

    def reset(self) -> None:
        """Take the camera to stand where it stood when the networks were trained."""
        self._factor = np.eye(3)
        self._updates = 0
        self._refused = 0
        self._watch = TurnWatch()
        self._doubts = CameraDoubts()
        self._sample: tuple[np.ndarray, np.ndarray] | None = None
        self._begin(self._config.trust_m)

    def _begin(self, trust_m: float) -> None:
        """Forget all steps; the factor so far counts like a step of a length each way."""
        self._prior, self._prior_m2 = self._factor, trust_m**2
        self._cross, self._gram = np.zeros((3, 3)), np.zeros((3, 3))

    @property
    def doubts(self) -> CameraDoubts:
        """What does not fit."""
        return self._doubts

    @property
    def camera_rotation(self) -> np.ndarray:
        """The factor's rotation, (3, 3)."""
        return nearest_rotation(self._factor)

    @property
    def factor(self) -> np.ndarray:
        """A, shape (3, 3); a copy."""
        return self._factor.copy()

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad, shape (3, 6)."""
        return self._factor @ super().jacobian(joints_rad)

    def observe(self, joints_rad: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn the noise at rest."""
        if not math.isfinite(float(joints_rad.dot(joints_rad) + ball_m.dot(ball_m))):
            return
        self._doubts.image()
        before, self._sample = self._sample, (joints_rad, ball_m)
        if before is not None and np.abs(joints_rad - before[0]).max() < _STILL_RAD:
            self._watch.rest(ball_m - before[1])

    def update(self, step: MotionStep) -> None:
        """Learn from one step; too little motion or anything not finite changes nothing."""
        config = self._config
        predicted, seen = super().jacobian(step.joints_rad) @ step.d_joints_rad, step.d_ball_m
        predicted_m2, seen_m2 = float(predicted.dot(predicted)), float(seen.dot(seen))
        if not (step.dt_s > 0.0 and math.isfinite(predicted_m2 + seen_m2)):
            self._refused += 1
            return
        if np.abs(step.d_joints_rad).max() < config.min_motion_rad:
            return
        # However the camera may have been turned, the ball goes as far as predicted.
        most_m = max(config.bump_m, _BUMP_DEVIATIONS * self._watch.deviation_m)
        if math.sqrt(seen_m2) - math.sqrt(predicted_m2) > most_m:
            self._doubts.bump()
            self._watch.clear()
            self._begin(config.bumped_trust_m)
            return
        turned = self._watch.add(self._factor, predicted, seen)
        if turned:
            self._doubts.bump()
            self._begin(config.bumped_trust_m)
        for one in turned or [(predicted, seen)]:
            self._learn(*one)
        self._updates += 1

    def _learn(self, predicted: np.ndarray, seen: np.ndarray) -> None:
        config = self._config
        keep = math.exp(-length(predicted) / config.memory_m)
        # The little that is put back of the factor so far keeps what the steps do not tell,
        # however long they go along one line; the noisier they are, the more is put back. The start
        # counts the same however noisy they are: a turned camera is to be found soon.
        growth = max(1.0, (self._watch.deviation_m / _KEPT_DEVIATION_M) ** 2)
        floor = (1.0 - keep) * config.bumped_trust_m**2 * growth
        self._cross = keep * self._cross + floor * self._factor + seen[:, None] * predicted
        self._gram = keep * self._gram + floor * _IDENTITY + predicted[:, None] * predicted
        self._prior_m2 *= keep
        cross = self._cross + self._prior_m2 * self._prior
        if config.kind == ROTATION:
            self._factor = self._believed(nearest_rotation(cross))
        else:
            self._factor = np.linalg.solve(self._gram + self._prior_m2 * _IDENTITY, cross.T).T

    def _believed(self, found: np.ndarray) -> np.ndarray:
        """As much of a rotation that was found as noise would not feign.

        Where noise alone tells three numbers, the steps seem explained better by three variances.
        James and Stein's estimate (1961) goes back to the start by one of them.
        """
        apart = found - self._prior
        told_m2 = float(((apart @ self._gram) * apart).sum())
        share = 1.0 - self._watch.deviation_m**2 / max(told_m2, 1e-12)
        return nearest_rotation(self._prior + share * apart) if share > 0.0 else self._prior

    def status_values(self) -> dict[str, float]:
        """Counts, and how far the factor turns the networks' Jacobian."""
        return {
            "updates": float(self._updates),
            "refused": float(self._refused),
            "camera_turned_deg": math.degrees(rotation_angle_rad(nearest_rotation(self._factor))),
            **super().status_values(),
        }
