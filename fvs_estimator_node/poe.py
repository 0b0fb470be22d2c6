"""The structured model online: a fitted serial chain, seen by a camera that may have been moved.

``J(r) = R J_chain(r)`` with the rotation R of the camera since the chain was fitted, which is
learned from absolute positions (:mod:`fvs_estimator_node.camera_motion`). The only assumption is
the chain's: six revolute joints in series, rigid in between.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.camera_doubts import CameraDoubts, CameraLearner
from fvs_estimator_node.camera_motion import CameraMotion, CameraMotionConfig
from fvs_ros.chain import SerialChain
from fvs_ros.params import Parameter

_DEFAULT = CameraMotionConfig()

#: Parameters of the method ``poe`` as a node declares them.
POE_PARAMETERS = (
    Parameter(
        "poe.rotation_deviation_rad",
        _DEFAULT.rotation_deviation_rad,
        "How far the camera may have been turned unnoticed, standard deviation, rad.",
        1e-5,
        3.0,
    ),
    Parameter(
        "poe.bumped_deviation_rad",
        _DEFAULT.bumped_deviation_rad,
        "The same at most once a bump was noticed, rad.",
        1e-3,
        3.0,
    ),
    Parameter(
        "poe.memory",
        _DEFAULT.memory,
        "Steps after which an old one's weight in the camera's pose has decayed by 63 %.",
        1.0,
        1e6,
    ),
    Parameter(
        "poe.bump_m",
        _DEFAULT.bump_m,
        "A position that is further off than this and six standard deviations of the noise may "
        "be the sign of a bump, m.",
        1e-4,
        1.0,
    ),
    Parameter(
        "poe.bump_repeats",
        _DEFAULT.bump_repeats,
        "So many of them in a row are a bump.",
        1,
        100,
    ),
)


def poe_config(values: Mapping[str, Any]) -> CameraMotionConfig:
    """Configuration from parameter values (``poe.memory`` and so on); others are passed over."""
    names = {field.name for field in fields(CameraMotionConfig)}
    return CameraMotionConfig(
        **{name: values[f"poe.{name}"] for name in names if f"poe.{name}" in values}
    )


class PoeEstimator(CameraLearner):
    """A fitted chain behind a camera that may have been moved.

    Parameters
    ----------
    chain : SerialChain
        The fitted chain.
    config : CameraMotionConfig, optional
        How the camera's pose is learned.
    """

    learns = True

    def __init__(self, chain: SerialChain, config: CameraMotionConfig | None = None) -> None:
        self._fitted = chain
        self._camera = CameraMotion(config)
        self._updates = 0
        self._refused = 0

    @property
    def updates(self) -> int:
        """How often the camera's pose was learned anew."""
        return self._updates

    @property
    def chain(self) -> SerialChain:
        """The chain as the camera sees it now."""
        return self._fitted.moved(self._camera.rotation, self._camera.translation_m)

    @property
    def camera(self) -> CameraMotion:
        """What is known of the camera's pose."""
        return self._camera

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad, shape (3, 6)."""
        return self._camera.rotation @ self._fitted.jacobian(joints_rad)

    @property
    def doubts(self) -> CameraDoubts:
        """What does not fit."""
        return self._camera.doubts

    @property
    def camera_rotation(self) -> np.ndarray:
        """How the camera has been turned since the chain was fitted, (3, 3)."""
        return self._camera.rotation

    def observe(self, joints_rad: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn the camera's pose from where the ball is."""
        if math.isfinite(float(joints_rad.dot(joints_rad))) and self._camera.add(
            self._fitted.position(joints_rad), ball_m
        ):
            self._updates += 1
        else:
            self._refused += 1

    def update(self, step: MotionStep) -> None:
        """Learn nothing more: each position has been heard."""

    def reset(self) -> None:
        """Take the camera to stand where it stood when the chain was fitted."""
        self._camera.reset()
        self._updates = 0
        self._refused = 0

    def status_values(self) -> dict[str, float]:
        """Counts, how far the camera has been turned, bumps and noise."""
        camera = self._camera
        return {
            "updates": float(self._updates),
            "refused": float(self._refused),
            "camera_turned_deg": math.degrees(camera.angle_rad),
            "position_noise_m": camera.noise_m,
            **super().status_values(),
        }
