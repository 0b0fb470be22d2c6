"""What a calibration found: the camera's pose, how well it is known, and what was wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fvs_ros.urdf import Kinematics

#: A part of the URDF does not fit if it is off by so many deviations, and by this, rad.
_SIGMAS, _ZERO_OFF_RAD = 5.0, np.radians(0.2)
#: An encoder is off by more than this share.
_ENCODER_OFF = 0.001
#: Deviations of the camera's place, m, and turn, rad, of a calibration that is good, and usable.
GOOD, USABLE = (0.001, np.radians(0.1)), (0.01, np.radians(1.0))
#: With a zero of this size, rad, the joint turns the other way, or is another.
OTHER_RAD = np.radians(10.0)
#: No camera is as near to the origin of the arm's base, m, which is inside of it.
_IN_BASE_M = 0.001
#: A remedy that leaves this share of the deviation is none.
_NO_HELP = 0.8


class Remedy(NamedTuple):
    """What else the arm could do, and the standard deviations that it would leave, m and rad."""

    words: str
    deviation_m: float
    deviation_rad: float
    zeros_deviation_rad: np.ndarray


class Displaced(NamedTuple):
    """A joint that is not where the URDF has it, seen from the joint before: by m and rad."""

    joint: str
    shift_m: float
    turn_rad: float

    def __str__(self) -> str:
        size = f"{1e3 * self.shift_m:.1f} mm and {np.degrees(self.turn_rad):.1f} degrees"
        return f"{self.joint} is about {size} from where the URDF has it"


class CalibrationError(ValueError):
    """Data that no camera can be calibrated from; the text says why."""


@dataclass(frozen=True)
class Calibration:
    """A camera's pose, and what else the images told.

    Parameters
    ----------
    arm : Kinematics
        From the URDF; read from the tip, if the arm carries the camera.
    camera : str
        The camera's frame: ``x_parent = R x_camera + t``, where the parent is the arm's root.
    rotation, translation_m : ndarray, shapes (3, 3) and (3,)
        R, and t, m.
    covariance : ndarray, shape (6, 6)
        Of t, m, and of the rotation vector that turns R, rad, both in the parent's frame.
    carried_m, carried_rotation : ndarray, shape (3,), and ndarray, shape (3, 3), or None
        Place of the ball, or pose of the tag, in the frame of the tip (of the root for a camera
        that the arm carries), m.
    delay_s, delay_deviation_s : float
        How late the images are stamped, and its standard deviation, s.
    scale, scale_deviation : float
        Lengths that the camera reports over true ones, and the standard deviation.
    focal, focal_deviation : float
        The focal length over the one that the camera counts with.
    radial, radial_deviation : float
        First coefficient of distortion (k1) that the camera does not know of.
    encoders, encoders_deviation : ndarray, shape (n,)
        True motion of each joint over the reported one, less 1.
    zeros_rad, zeros_deviation_rad : ndarray, shape (n,)
        What has to be added to each reported joint for the URDF, rad (m); infinite deviations where
        the motion does not tell.
    residual_m : float
        Median distance of the images from the model, m.
    stamps_s, seen_m, residuals_m : ndarray, shapes (k,), (k, 3) and (k, 3)
        Of each image: its stamp, s, where it shows ball or tag, m, and how far off the model is, m.
    outliers : int
        Images further than six standard deviations from the model.
    displaced : Displaced, optional
        If the links are off: the joint that explains most.
    remedies : tuple of Remedy
        What other motion would have told, the least change first; empty if this did.
    """

    arm: Kinematics
    camera: str
    rotation: np.ndarray
    translation_m: np.ndarray
    covariance: np.ndarray
    carried_m: np.ndarray
    carried_rotation: np.ndarray | None
    delay_s: float
    delay_deviation_s: float
    scale: float
    scale_deviation: float
    focal: float
    focal_deviation: float
    radial: float
    radial_deviation: float
    encoders: np.ndarray
    encoders_deviation: np.ndarray
    zeros_rad: np.ndarray
    zeros_deviation_rad: np.ndarray
    residual_m: float
    stamps_s: np.ndarray
    seen_m: np.ndarray
    residuals_m: np.ndarray
    outliers: int
    displaced: Displaced | None = None
    remedies: tuple[Remedy, ...] = ()

    def seen(self, points_m: np.ndarray) -> np.ndarray:
        """Points of the parent's frame, m, (k, 3), in the camera's, where its image shows them."""
        seen = (points_m - self.translation_m) @ self.rotation
        square = np.sum((seen[:, :2] / seen[:, 2:]) ** 2, axis=1, keepdims=True)
        seen[:, :2] *= self.focal * (1.0 + self.radial * square)
        return np.asarray(seen)

    def true_joints(self, joints_rad: np.ndarray) -> np.ndarray:
        """The URDF's joints, rad (m), (..., n), of reported ones."""
        return np.asarray((1.0 + self.encoders) * joints_rad + self.zeros_rad)

    @property
    def deviation_m(self) -> float:
        """Standard deviation of the camera's place, m."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def deviation_rad(self) -> float:
        """Standard deviation of the camera's turn, rad."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def verdict(self) -> tuple[str, str]:
        """``good``, ``poor`` or ``unusable``, and the reason."""
        sizes = _sizes(self.deviation_m, self.deviation_rad)
        exact = f"the camera is known to {sizes} (standard deviation)"

        def within(limits: tuple[float, float]) -> bool:
            return self.deviation_m < limits[0] and self.deviation_rad < limits[1]

        wrong = np.abs(self.zeros_rad) > np.where(self.arm.prismatic > 0.0, np.inf, OTHER_RAD)
        if wrong.any():
            name = self.arm.names[int(np.argmax(wrong * np.abs(self.zeros_rad)))]
            turned = (
                "differs from the URDF by more than 10 degrees: are joints swapped or mirrored?"
            )
            return "unusable", f"{name} {turned}"
        if not within(USABLE):
            return "unusable", f"{exact}: {self._remedy()}"
        away_m = np.linalg.norm(np.reshape(self.arm.base_m, (-1, 3)) - self.translation_m, axis=1)
        if away_m.min(initial=np.inf) < max(_IN_BASE_M, 3.0 * self.deviation_m):
            return "unusable", (
                f"{self.camera} is where the arm's base is: these are places that the robot says "
                "it has, not what a camera sees; name the topic of ball or tag"
            )
        if self.displaced is not None:
            return "poor", f"{self.displaced}; {exact}"
        if not within(GOOD):
            return "poor", f"{exact}: {self._remedy()}"
        return "good", exact

    def _remedy(self) -> str:
        """What would make the calibration more exact."""
        if self.displaced is not None:
            return str(self.displaced)
        if not self.remedies:
            return ""
        best = min(  # the first that is enough
            self.remedies,
            key=lambda one: max(one.deviation_m / GOOD[0], one.deviation_rad / GOOD[1], 1.0),
        )
        if self.deviation_m > USABLE[0] and best.deviation_m > _NO_HELP * self.deviation_m:
            way = np.linalg.eigh(self.covariance[:3, :3])[1][:, -1]
            along = ", ".join(f"{one:.2f}" for one in way)
            return f"no motion of these joints tells the place along ({along}) of {self.arm.root}"
        return f"{best.words} to know it to {_sizes(best.deviation_m, best.deviation_rad)}"

    def notes(self) -> list[str]:
        """What else is off, and what the motion did not tell."""
        found = []
        for name, zero, deviation, shifts in zip(
            self.arm.names,
            self.zeros_rad,
            self.zeros_deviation_rad,
            self.arm.prismatic > 0.0,
            strict=True,
        ):
            if abs(zero) > max(_SIGMAS * deviation, _ZERO_OFF_RAD):
                size = f"{-1e3 * zero:+.1f} mm" if shifts else f"{np.degrees(-zero):+.2f} degrees"
                found.append(
                    f"the zero of {name} is off by {size}, {abs(zero) / deviation:.0f} sigma"
                )
        for name, encoder, deviation in zip(
            self.arm.names, self.encoders, self.encoders_deviation, strict=True
        ):
            if abs(encoder) > max(_SIGMAS * deviation, _ENCODER_OFF):
                found.append(f"{name} moves {100.0 * encoder:+.2f} % further than it reports")
        blind = [self.arm.names[0], self.arm.names[-1]]
        inside = slice(1, -1)
        unsure = np.isinf(self.zeros_deviation_rad[inside])
        found.append(f"no camera can tell the zeros of {' and '.join(dict.fromkeys(blind))}")
        if unsure.any():
            names = ", ".join(np.array(self.arm.names)[inside][unsure])

            def left(one: Remedy) -> int:
                return int(np.count_nonzero(np.isinf(one.zeros_deviation_rad[inside][unsure])))

            best = min(self.remedies, key=left)
            helps = best.words if left(best) < unsure.sum() else "none twice as far does"
            found.append(f"this motion does not tell the zeros of {names}: {helps}")
        if abs(self.scale - 1.0) > max(_SIGMAS * self.scale_deviation, 0.002):
            found.append(
                f"the camera reports lengths {100.0 * (self.scale - 1.0):+.2f} % too long: is the "
                "size of ball or tag right?"
            )
        if abs(self.focal - 1.0) > max(_SIGMAS * self.focal_deviation, 0.002):
            found.append(
                f"the focal length is {100.0 * (self.focal - 1.0):+.2f} % longer than the camera "
                "counts with: is its camera_info right?"
            )
        if abs(self.radial) > max(_SIGMAS * self.radial_deviation, 0.01):
            found.append(f"the lens has a distortion of k1 = {self.radial:.3f} that is not removed")
        return found


def _sizes(deviation_m: float, deviation_rad: float) -> str:
    place_mm = 1e3 * deviation_m
    place = f"{place_mm:.0f}" if place_mm >= 10.0 else f"{place_mm:.2g}"
    return f"{place} mm and {np.degrees(deviation_rad):.2g} degrees"
