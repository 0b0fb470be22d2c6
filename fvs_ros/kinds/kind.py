"""What a kind of feature is: how it is measured, how it moves, and what it is called."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fvs_ros.chain import cross_matrix
from fvs_ros.params import Parameters
from fvs_ros.topics import KindTopics, Topic
from fvs_ros.vectors import LARGEST, length, plausible

_TWISTS = np.eye(6)
#: No camera sees what is nearer, m: zeros are what some trackers send while they see nothing.
_NEAREST_M = 1e-3
#: Numbers that are further than this from any measurement of their kind are none.
_NO_MEASUREMENT = 0.01
#: Values of the parameter ``camera_mount``.
FIXED, ON_ARM = MOUNTS = ("fixed", "arm")
#: Name of the usual camera.
UNNAMED = ""


@dataclass(frozen=True)
class Kind(Parameters):
    """A measurement is m numbers z; a motion of it is a tangent vector of d lengths, m.

    This class is the kind whose z is a vector, so that d is m; by default, of lengths.
    Other kinds override what differs, and declare their parameters.
    """

    #: Value of the parameter ``feature``, and what the camera looks for, in a word.
    name = what = ""
    #: Trained models of the simulated arm that come with the package: before a fixed camera, and
    #: with the camera on the arm.
    models: ClassVar[tuple[str, str]] = ("", "")
    topics: ClassVar[KindTopics]
    #: Names of the numbers that a person writes of a measurement.
    columns: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    axes: ClassVar[tuple[str, ...]] = ()  #: names of the d components of a tangent vector
    outliers = 0.01  #: share of images that are usually further off than their noise
    box_size = 3  #: count of the first numbers of z that a workspace box bounds; 0 without one
    least_joints = 1  #: fewest joints that can servo it
    rigid = True  #: whether it is measured of a rigid body, which twists of space move

    #: ``fixed`` in the room, the camera sees what rides on the arm; on the ``arm``, what stands in
    #: the room.
    camera_mount: str = field(default=FIXED, kw_only=True)

    @classmethod
    def of_numbers(
        cls, count: int, camera_mount: str, cameras: tuple[str, ...] = (UNNAMED,)
    ) -> Kind:
        """The kind with the usual parameters of which a file may hold ``count`` numbers."""
        if cameras != (UNNAMED,):
            raise ValueError(f"a {cls.name} is seen by one camera, got {cameras}")
        return cls(camera_mount=camera_mount)

    @property
    def values(self) -> dict[str, Any]:
        """Parameters that make it, by name."""
        own = {each.name: getattr(self, each.name) for each in self.declared()}
        return {"feature": self.name, "camera_mount": self.camera_mount, **own}

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that see it; one without a name has topics without a prefix."""
        return (UNNAMED,)

    @property
    def parts(self) -> tuple[Kind, ...]:
        """What each camera measures: a measurement is theirs, one after the other."""
        return (self,)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """Which numbers of a measurement, and components of a motion, are of each camera."""
        count = len(self.cameras)
        size = self.size // count
        if count == 1:
            return (slice(None),)
        return tuple(slice(i * size, (i + 1) * size) for i in range(count))

    @property
    def on_arm(self) -> bool:
        """Whether the camera is on the arm."""
        return self.camera_mount == ON_ARM

    @property
    def model(self) -> str:
        """The model that comes with the package for the camera's mount."""
        return self.models[self.on_arm]

    @property
    def flat(self) -> bool:
        """Whether the motion by given joints does not depend on z, to those that learn it."""
        return not self.on_arm

    @property
    def feature(self) -> Topic:
        """Where what is servoed is published: the tool; to a camera on the arm, the object."""
        return self.topics.object if self.on_arm else self.topics.tool

    @property
    def truth(self) -> Topic:
        """Where a simulator's truth of it is."""
        return self.topics.object_truth if self.on_arm else self.topics.truth

    @cached_property
    def unit(self) -> np.ndarray:
        """Length of what a message gives as 1, m, (d,)."""
        return np.ones(len(self.axes))

    @cached_property
    def weights(self) -> np.ndarray:
        """Length of a unit of each number of z, m, (m,)."""
        return self.unit

    @property
    def learned(self) -> np.ndarray:
        """Units of what networks learn, m: of z, or, with the camera on the arm, of a twist."""
        return np.ones(6) if self.on_arm else self.weights

    @property
    def numbers(self) -> int:
        """Count of numbers of a measurement, m."""
        return len(self.weights)

    @property
    def size(self) -> int:
        """Count of components of a motion, d."""
        return len(self.axes)

    @property
    def any_frame(self) -> bool:
        """Whether its messages may name any frame, as their topic says which camera they are of."""
        return self.cameras != (UNNAMED,)

    @property
    def freedom(self) -> int:
        """Most components of its task that an arm can move independently."""
        return self.size

    def possible(self, jacobian: np.ndarray) -> np.ndarray:
        """The nearest Jacobian, (d, n), of no more motions than an arm can make."""
        return jacobian

    # ---- messages: any object with the fields of the message's type --------------------------

    def checked(self, z: np.ndarray) -> np.ndarray:
        """A measurement, (m,); a ``ValueError`` if it is none, not finite, or too far away."""
        if z.shape != (self.numbers,):
            raise ValueError(f"has numbers of shape {z.shape}, expected ({self.numbers},)")
        if not plausible(self.weights * z):
            numbers = self.columns_of(z).tolist()
            raise ValueError(f"is not finite, or further than {LARGEST:g} m: {numbers}")
        if not self.fits(z):
            raise ValueError(f"is no {self.name}: {np.round(z, 3).tolist()}")
        if self.on_arm and self.rigid and length(z[:3]) < _NEAREST_M:
            raise ValueError(f"is at the camera itself: {self.columns_of(z).tolist()}")
        return z

    def fits(self, z: np.ndarray) -> bool:
        """Whether finite numbers, (m,), are nearly those of a measurement."""
        return bool(np.abs(self.nearest(z) - z).max() <= _NO_MEASUREMENT)

    def unseen(self, z: np.ndarray) -> str:
        """Why no camera can measure z, (m,), in words; empty if one may."""
        return ""

    def read(self, message: Any) -> np.ndarray:
        """Measurement of a message of the topics ``tool`` and ``target``; not checked for size.

        A ``ValueError`` says what is wrong with it.
        """
        raise NotImplementedError

    def write(self, message: Any, z: np.ndarray) -> None:
        """Fill in such a message."""
        raise NotImplementedError

    def read_sliding(self, message: Any) -> np.ndarray:
        """Sliding variable of a message, m, (d,); a ``ValueError`` if it has not d components."""
        if len(message.data) != self.size:
            raise ValueError(f"has {len(message.data)} values, expected {self.size}")
        return np.array(message.data) * self.unit

    def write_sliding(self, message: Any, sliding_m: np.ndarray) -> None:
        """Fill in the message of a sliding variable, m, (d,)."""
        message.data = (sliding_m / self.unit).tolist()

    def parse(self, numbers: np.ndarray) -> np.ndarray:
        """Measurement of the numbers that a person writes, finite; a ``ValueError`` if wrong."""
        if len(numbers) != len(self.columns):
            names = " ".join(self.columns)
            raise ValueError(f"has {len(self.columns)} numbers, {names}, got {len(numbers)}")
        return self.checked(self.of_columns(numbers))

    def of_columns(self, numbers: np.ndarray) -> np.ndarray:
        """Measurement of the numbers that a person writes; unchecked."""
        return numbers

    def columns_of(self, z: np.ndarray) -> np.ndarray:
        """The numbers that a person writes of a measurement: the inverse of ``of_columns``."""
        return z

    # ---- motion ------------------------------------------------------------------------------

    def minus(
        self, z: np.ndarray, origin: np.ndarray, before: np.ndarray | None = None
    ) -> np.ndarray:
        """Motion from a measurement ``origin`` to z, m, (d,).

        Near 180 degrees, the direction of rotation of a motion ``before`` is kept.
        """
        return self.unit * (z - origin)

    def retract(self, z: np.ndarray, motion_m: np.ndarray) -> np.ndarray:
        """The measurement that a motion, m, (d,), leads to from z: the inverse of ``minus``."""
        return z + motion_m / self.unit

    def error(
        self, z: np.ndarray, target: np.ndarray, before: np.ndarray | None = None
    ) -> np.ndarray:
        """Motion to z, m, (d,), from the nearest measurement that does for a target."""
        return self.minus(z, target, before)

    def of_task(self, z: np.ndarray | None, motion_m: np.ndarray) -> np.ndarray:
        """Of motions, m, (d, ...), of z what changes the error."""
        return motion_m

    def moved_by(self, z: np.ndarray, angular: np.ndarray, linear_m: np.ndarray) -> np.ndarray:
        """Motions, m, (..., d, n), of z by n twists of space: ``v + w x p`` of a point p.

        Parameters
        ----------
        z : ndarray, shape (..., m)
            The measurement.
        angular, linear_m : ndarray, shape (..., n, 3)
            Angular velocity w, rad, and velocity v, m, of what is at the camera's origin.
        """
        moved = linear_m + angular @ cross_matrix(z[..., :3])
        return np.asarray(np.swapaxes(moved, -1, -2))

    def along(self, chain: Any, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The measurement, (m,), and its Jacobian, m/rad, (d, n), by a chain at joints, (n,)."""
        z, angular, linear_m = chain.motion(joints_rad)
        return z, self.moved_by(z, angular, linear_m)

    def to_tangent(self, z: np.ndarray | None, motion_m: np.ndarray) -> np.ndarray:
        """Tangent vectors, m, (d, ...), of motions of what is learned, (l, ...), at z."""
        basis = self._basis(z)
        return motion_m if basis is None else basis @ motion_m

    def from_tangent(self, z: np.ndarray | None, motion_m: np.ndarray) -> np.ndarray:
        """Motions of what is learned, (l, ...), of tangent vectors, m, (d, ...), at z."""
        basis = self._basis(z)
        return motion_m if basis is None else basis.T @ motion_m

    def _basis(self, z: np.ndarray | None) -> np.ndarray | None:
        """Motions, m, (d, l), of z by units of what is learned; None if both are the same."""
        if not self.on_arm:
            return None
        assert z is not None
        return self.moved_by(z, _TWISTS[:, :3], _TWISTS[:, 3:])

    def nearest(self, numbers: np.ndarray) -> np.ndarray:
        """The measurement nearest to any numbers, (m,): of a mean or a polynomial, say."""
        return numbers

    def through_lens(self, z: np.ndarray, focal: float, radial: float) -> np.ndarray:
        """What a camera measures, (k, m), of z, (k, m), that counts with a wrong lens.

        Parameters
        ----------
        z : ndarray, shape (k, m)
            The measurements with the true lens.
        focal : float
            True focal length over the assumed one, less 1.
        radial : float
            First coefficient of distortion (k1) that is not removed.
        """
        return z * self._lens_factor(z, focal, radial)

    def without_lens(self, z: np.ndarray, focal: float, radial: float) -> np.ndarray:
        """The inverse of ``through_lens``, but for the square of the error."""
        return z / self._lens_factor(z, focal, radial)

    def _lens_factor(self, z: np.ndarray, focal: float, radial: float) -> np.ndarray:
        square = np.sum((z[:, :2] / z[:, 2:3]) ** 2, axis=1, keepdims=True)
        factor = (1.0 + focal) * (1.0 + radial * square)
        return np.concatenate([factor, factor, np.ones_like(factor)], axis=1)

    # ---- relative to an object ---------------------------------------------------------------

    def relative(self, z: np.ndarray, object_z: np.ndarray) -> np.ndarray:
        """The measurement z, (m,), in the frame of an object that is measured as well, (m,)."""
        return z - object_z

    def absolute(self, relative_z: np.ndarray, object_z: np.ndarray) -> np.ndarray:
        """The measurement, (m,), that is ``relative_z``, (m,), in the object's frame."""
        return object_z + relative_z

    def inverse(self, z: np.ndarray) -> np.ndarray:
        """The camera's frame as seen from what it sees as z, (m,)."""
        return self.relative(self.of_body(np.zeros(3), np.eye(3)), z)

    # ---- rigid bodies ------------------------------------------------------------------------

    def of_body(self, position_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """What is measured of a body at a position, m, (3,), with a rotation matrix, (3, 3)."""
        return position_m

    def of_detection(self, detection: Any) -> np.ndarray:
        """What is measured of what a detector found."""
        return self.of_body(detection.position_m, detection.rotation)

    def rotation(self, z: np.ndarray) -> np.ndarray | None:
        """The body's rotation matrix, (3, 3); None for a kind that has none."""
        return None

    def directions(self, z: np.ndarray) -> np.ndarray:
        """Directions that turn with the body, weighted, m, (k, 3)."""
        return np.zeros((0, 3))

    def facing(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosines, (k,), of how flat the camera sees each face, and their slopes, 1/m, (k, d)."""
        return np.zeros(0), np.zeros((0, self.size))

    # ---- words -------------------------------------------------------------------------------

    def text(self, z: np.ndarray) -> str:
        """A measurement in words."""
        lengths_m = self.weights[: len(z)] * z
        return f"({', '.join(self.length_text(length_m, 1) for length_m in lengths_m)})"

    def length_text(self, length_m: float, digits: int = 0) -> str:
        """A length, m, in words."""
        return f"{1e3 * length_m:.{digits}f} mm"

    def error_text(self, error_m: np.ndarray) -> str:
        """An error, m, (d,), in words."""
        return self.length_text(length(error_m), 1)

    def parts_m(self, errors_m: np.ndarray) -> dict[str, np.ndarray]:
        """Lengths, m, (...), of the parts of errors, m, (..., d), each of which is to vanish."""
        return {"way_m": np.linalg.norm(errors_m, axis=-1)}

    def status_values(self, error_m: np.ndarray | None) -> dict[str, float]:
        """Lengths of an error, m and rad, by name; NaN without one."""
        return {"error_m": float("nan") if error_m is None else length(error_m)}


class ErrorText(NamedTuple):
    """An error, m, (d,), that becomes words only when it is read."""

    kind: Kind
    error_m: np.ndarray

    def __str__(self) -> str:
        return self.kind.error_text(self.error_m)
