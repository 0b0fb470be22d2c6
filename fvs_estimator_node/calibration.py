"""Where the camera is: the fitted chain, registered with the arm's URDF. No ROS, no clock.

A chain that was fitted to images (:mod:`fvs_estimator_node.chain_fit`) has the arm's axes as lines
in the camera's frame; the URDF has them in its root's. The turn that takes one to the other comes
from their directions, the shift from their places. From there on robust least squares on the images
find camera, place of ball or tag on the tip, delay of the images, scale of the camera and zeros of
the joints together. A camera that is carried by the arm and looks at something fixed is the same
with the chain read from its other end.

A camera cannot tell the zero of the first joint from its own place, nor that of the last joint from
the place of ball or tag: both zeros count as exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_chart import Chart
from fvs_estimator_node.chain_fit import ChainFit, fit_chain, inliers, whitening
from fvs_estimator_node.chain_start import Path
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.feature import PoseFeature, rotation_matrix
from fvs_ros.urdf import Kinematics

#: A joint that moves less, rad or m (standard deviation), determines nothing.
_STILL = 0.02
#: Prior deviations: of the joints' zeros, rad; of the images' delay, s; of the camera's scale and
#: focal length; of all else, from where the registration puts it, m and rad.
_ZERO_RAD, _DELAY_S, _SCALE, _FOCAL, _ANYWHERE = 0.05, 0.1, 0.05, 0.005, 1.0
#: A part of the URDF does not fit if it is off by so many deviations, and by this, rad.
SIGMAS, _ZERO_OFF_RAD = 5.0, np.radians(0.2)
#: Deviations of the camera's place, m, and turn, rad, of a calibration that is good, and usable.
GOOD, USABLE = (0.001, np.radians(0.1)), (0.01, np.radians(1.0))
#: Blocks of images, s: residuals within one may be alike. Of an error that all images share, such
#: as a detector's bias, no residual tells; it counts as this share of an image's noise.
_BLOCK_S, _COMMON = 2.0, 0.3
#: Sine of the angle below which two axes are parallel.
_PARALLEL = 0.05
#: Largest length of a residual over its noise, for a robust fit.
_ROBUST = 2.0


#: With this misfit the URDF does not fit. A model this many times as far from the images as a free
#: chain is wrong, and so is a zero of this size, rad: the joint turns the other way, or is another.
_UNFIT, _WRONG, _OTHER_RAD = 10.0, 3.0, np.radians(10.0)
#: Images are explained if they are nearer than this many times their noise.
_EXPLAINED = 1.6
#: The free chain is at a wrong optimum if the URDF's is this much nearer to the images.
_BETTER = 0.7
#: Moments at which the camera may have been moved, and share of the squared residuals that this
#: must explain.
_MOMENTS, _BUMPED = 40, 0.2


class CalibrationError(ValueError):
    """Data that no camera can be calibrated from; the text says why."""


@dataclass(frozen=True)
class Calibration:
    """A camera's pose, and what else the images told.

    Parameters
    ----------
    parent, camera : str
        Frames: ``x_parent = R x_camera + t``. The parent is the root of the URDF, or the tip for a
        camera that the arm carries.
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
        The same across the line of sight over along it, such as by a wrong focal length.
    joint_names : tuple of str
        The joints from root to tip.
    zeros_rad, zeros_deviation_rad : ndarray, shape (n,)
        What has to be added to each reported joint for the URDF, rad (m); infinite deviations where
        the motion does not tell.
    prismatic : ndarray of bool, shape (n,)
        Which joints are.
    residual_m, misfit : float
        Median distance of the images from the model, m; and the squares that displaced links would
        explain, over those of noise: about 1 for a URDF that fits.
    stamps_s, seen_m, residuals_m : ndarray, shapes (k,), (k, 3) and (k, 3)
        Of each image: its stamp, s, where it shows ball or tag, m, and how far off the model is, m.
    axes, points_m : ndarray, shape (n, 3)
        The joints' axes as the camera sees them at the mean joints, m.
    outliers : int
        Images further than six standard deviations from the model.
    unfitting : tuple of str, float, float
        Where the misfit is large: the joint that is not where the URDF has it, seen from the joint
        before, and by how much, m and rad.
    """

    parent: str
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
    joint_names: tuple[str, ...]
    zeros_rad: np.ndarray
    zeros_deviation_rad: np.ndarray
    prismatic: np.ndarray
    residual_m: float
    misfit: float
    stamps_s: np.ndarray
    seen_m: np.ndarray
    residuals_m: np.ndarray
    axes: np.ndarray
    points_m: np.ndarray
    outliers: int
    unfitting: tuple[str, float, float] | None = None

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
        place_mm = 1e3 * self.deviation_m
        place = f"{place_mm:.0f} mm" if place_mm >= 10.0 else f"{place_mm:.2g} mm"
        turn = f"{np.degrees(self.deviation_rad):.2g} degrees"
        exact = f"the camera is known to {place} and {turn} (standard deviation)"

        def within(limits: tuple[float, float]) -> bool:
            return self.deviation_m < limits[0] and self.deviation_rad < limits[1]

        wrong = np.abs(self.zeros_rad) > np.where(self.prismatic, np.inf, _OTHER_RAD)
        if wrong.any():
            name = self.joint_names[int(np.argmax(np.abs(self.zeros_rad)))]
            return "unusable", f"{name} differs from the URDF by more than 10 degrees"
        if not within(USABLE):
            return "unusable", f"{exact}: {self._remedy()}"
        if self.unfitting is not None:
            return "poor", f"{_words(*self.unfitting)}; {exact}"
        if not within(GOOD):
            return "poor", f"{exact}: {self._remedy()}"
        return "good", exact

    def _remedy(self) -> str:
        """What would make the calibration more exact."""
        values, ways = np.linalg.eigh(self.covariance[:3, :3])
        if values[-1] > 100.0 * values[-2] and values[-1] > USABLE[0] ** 2:
            way = ", ".join(f"{one:.2f}" for one in ways[:, -1])
            return f"no motion of these joints tells the place along ({way}) of {self.parent}"
        if self.unfitting is not None:
            return _words(*self.unfitting)
        return "move the joints further, or for longer"

    def notes(self) -> list[str]:
        """Zeros that are off, and what the motion did not tell."""
        found = []
        for name, zero, deviation, shifts in zip(
            self.joint_names, self.zeros_rad, self.zeros_deviation_rad, self.prismatic, strict=True
        ):
            if abs(zero) > max(SIGMAS * deviation, _ZERO_OFF_RAD):
                size = f"{-1e3 * zero:+.1f} mm" if shifts else f"{np.degrees(-zero):+.2f} degrees"
                found.append(
                    f"the zero of {name} is off by {size}, {abs(zero) / deviation:.0f} sigma"
                )
        blind = [self.joint_names[0], self.joint_names[-1]]
        unsure = [
            name
            for name, deviation in zip(self.joint_names, self.zeros_deviation_rad, strict=True)
            if not np.isfinite(deviation) and name not in blind
        ]
        found.append(f"no camera can tell the zeros of {' and '.join(dict.fromkeys(blind))}")
        if unsure:
            found.append(
                f"this motion does not tell the zeros of {', '.join(unsure)}: move these and their "
                "neighbours further"
            )
        if abs(self.scale - 1.0) > max(SIGMAS * self.scale_deviation, 0.002):
            found.append(
                f"the camera reports lengths {100.0 * (self.scale - 1.0):+.2f} % too long: is the "
                "size of ball or tag right?"
            )
        if abs(self.focal - 1.0) > max(SIGMAS * self.focal_deviation, 0.002):
            found.append(
                f"lengths across the line of sight are {100.0 * (self.focal - 1.0):+.2f} % longer "
                "than along it: is the focal length right?"
            )
        return found


def _words(name: str, shift_m: float, turn_rad: float) -> str:
    return (
        f"{name} is about {1e3 * shift_m:.1f} mm and {np.degrees(turn_rad):.1f} degrees from where "
        "the URDF has it"
    )


def calibrate(
    data: DataSet,
    arm: Kinematics,
    carries_camera: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Find the camera in the arm's frame.

    Parameters
    ----------
    data : DataSet
        Images of a ball or tag on the tip of the moving arm; or, if the arm carries the camera, of
        a ball or tag at rest.
    arm : Kinematics
        From the URDF.
    carries_camera : bool
        Whether the camera is on the tip.
    progress : callable, optional
        Called with a text at each stage.

    Raises
    ------
    CalibrationError
        If joints do not fit together or did not move, or nothing fits.
    """
    say = progress or (lambda words: None)
    arm = arm.reversed() if carries_camera else arm
    names, spread = data.joint_names, data.joints_rad.std(axis=0).tolist()
    data = _ordered(data, arm)
    fit = fit_chain(data, say)
    say("registering the chain with the URDF")
    with threadpool_limits(1):
        return _Calibrating(data, arm, fit, names, spread).run()


def _ordered(data: DataSet, arm: Kinematics) -> DataSet:
    """The data with the joints of the URDF, in its order."""
    missing = [name for name in arm.names if name not in data.joint_names]
    if missing:
        raise CalibrationError(
            f"the data lack {', '.join(missing)[:200]}, which move {arm.tip} in the URDF; "
            f"they hold {', '.join(data.joint_names)[:400]}"
        )
    columns = [data.joint_names.index(name) for name in arm.names]
    joints = data.joints_rad[:, columns]
    still = [
        name for name, spread in zip(arm.names, joints.std(axis=0), strict=True) if spread < _STILL
    ]
    if still:
        raise CalibrationError(
            f"{', '.join(still)[:200]} never moved: move every joint, by 0.1 rad at least"
        )
    return replace(data, joints_rad=joints, joint_names=arm.names)


def _length(off_m: np.ndarray) -> float:
    """Median distance, m, of residuals, m, (k, m)."""
    return float(np.median(np.linalg.norm(off_m[:, :3], axis=1)))


def _across(axis: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """Direction of a way's part across an axis."""
    across = way_m - (way_m @ axis) * axis
    return np.asarray(across / max(np.linalg.norm(across), 1e-6))


class _Unknowns(NamedTuple):
    """Parts of the vector of unknowns."""

    turn: slice  # of the camera about the middle of what it saw, rad
    shift: slice  # of the camera, m
    carried: slice  # of ball or tag, m and rad
    zeros: slice  # of all joints but the first and the last, rad
    delay: int  # of the images, s
    scale: int  # logarithm of the camera's
    focal: int  # logarithm of its scale across the line of sight, over that along it
    size: int


class _Calibrating:
    """Least squares about the start that the registration gives."""

    def __init__(
        self,
        data: DataSet,
        arm: Kinematics,
        fit: ChainFit,
        names: Sequence[str],
        spread: Sequence[float],
    ) -> None:
        self._data, self._arm, self._fit, self._path = data, arm, fit, Path(data)
        self._names, self._spread = names, spread
        self._feature = data.servoed
        self._seen = data.ball_m[self._path.indices]
        self._middle = self._seen[:, :3].mean(axis=0)
        n, of_task = len(arm.names), len(self._feature.task_scale)
        zeros = slice(6 + of_task, 6 + of_task + max(0, n - 2))
        self._at = _Unknowns(
            slice(0, 3), slice(3, 6), slice(6, 6 + of_task), zeros, zeros.stop, zeros.stop + 1,
            zeros.stop + 2, zeros.stop + 3,
        )  # fmt: skip
        self._deviation = np.full(self._at.size, _ANYWHERE)
        self._deviation[zeros] = _ZERO_RAD
        self._deviation[self._at.delay] = _DELAY_S
        self._deviation[self._at.scale], self._deviation[self._at.focal] = _SCALE, _FOCAL
        joints = self._path.joints_and_velocities(fit.time_offset_s)[0]
        self._free_off = fit.chain.position(joints) - self._seen
        self._white = whitening(self._free_off, self._seen)
        # The arm as it stands at the fit's reference joints, carrying nothing yet.
        self._reference = fit.chain.reference_rad
        self._points, self._axes = arm.at(self._reference)
        self._rotation, self._shift = self._registered()
        carried = fit.chain.feature_m.reshape(-1, 3) @ self._rotation
        carried[0] -= self._shift @ self._rotation
        self._carried = carried.ravel()

    def _registered(self) -> tuple[np.ndarray, np.ndarray]:
        """Turn and shift, m, that take the URDF's axes to those that the camera saw."""
        seen, chart = self._fit.chain, Chart(self._fit.chain)
        variance = np.diag(self._fit.covariance)
        turn, place = (
            1.0 / np.maximum(variance[part].reshape(-1, 2).sum(axis=1), 1e-8)
            for part in (chart.turns, chart.shifts)
        )
        # Parallel axes tell no turn about themselves, but the ways from one to the next do.
        turning = np.flatnonzero(self._arm.prismatic == 0.0)
        pairs = [
            (i, j)
            for i, j in pairwise(turning)
            if np.linalg.norm(np.cross(self._axes[i], self._axes[j])) < _PARALLEL
        ]
        ways = [
            np.array([_across(axes[i], points[j] - points[i]) for i, j in pairs]).reshape(-1, 3)
            for axes, points in ((seen.axes, seen.points_m), (self._axes, self._points))
        ]
        weights = np.append(turn, [min(turn[i], turn[j]) for i, j in pairs])
        rotation = Rotation.align_vectors(
            np.concatenate([seen.axes, ways[0]]), np.concatenate([self._axes, ways[1]]), weights
        )[0].as_matrix()
        across = np.eye(3) - seen.axes[:, :, None] * seen.axes[:, None, :]
        across *= np.sqrt(place)[:, None, None]
        across[self._arm.prismatic > 0.0] = 0.0  # only the direction of a prismatic joint counts
        off = np.einsum("ijk,ik->ij", across, seen.points_m - self._points @ rotation.T)
        shift, *_ = np.linalg.lstsq(across.reshape(-1, 3), off.ravel(), rcond=None)
        return rotation, shift

    def _model(self, values: np.ndarray) -> np.ndarray:
        """The feature in all images, m, (k, m)."""
        at = self._at
        joints = self._path.joints_and_velocities(float(values[at.delay]))[0]
        joints[:, 1:-1] += values[at.zeros]
        seen = self._chain(values).position(joints)
        seen[:, :3] *= np.exp(values[at.scale])
        seen[:, :2] *= np.exp(values[at.focal])
        return seen

    def _chain(self, values: np.ndarray) -> SerialChain:
        carried = self._feature.displaced(
            self._carried, values[self._at.carried] * self._feature.task_scale
        )
        return SerialChain(
            self._axes, self._points, carried, self._reference, self._arm.prismatic
        ).moved(*self._camera(values))

    def _camera(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn and shift, m, from the arm's to the camera's frame."""
        turn = rotation_matrix(values[self._at.turn])
        shift = turn @ (self._shift - self._middle) + self._middle + values[self._at.shift]
        return turn @ self._rotation, shift

    def solve(
        self, evaluations: int = 50, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The unknowns, and how far the model is from the images, m, (k, m)."""

        def residuals(values: np.ndarray) -> np.ndarray:
            off = self._model(values) - self._seen
            return np.append(self._white @ off[..., None], values / self._deviation)

        if start is None:
            start = np.zeros(self._at.size)
            start[self._at.delay] = self._fit.time_offset_s
        found = least_squares(
            residuals, start, loss="soft_l1", f_scale=_ROBUST, x_scale="jac", max_nfev=evaluations
        )
        return found.x, self._model(found.x) - self._seen

    def _far(self, off: np.ndarray) -> float:
        """Distance of the typical image, over that from the free chain."""
        here, free = (
            np.median(np.linalg.norm(self._white @ one[..., None], axis=1))
            for one in (off, self._free_off)
        )
        return float(here / free)

    def run(self) -> Calibration:
        """The calibration."""
        values, off = self.solve()
        if _length(off) < _BETTER * _length(self._free_off):
            # In much noise the free chain may have one axis on the wrong side.
            self._free_off, self._white = off, whitening(off, self._seen)
            values, off = self.solve(start=values)
        self._check_camera()
        far = self._far(off)
        if far > _WRONG or np.abs(values[self._at.zeros]).max(initial=0.0) > _OTHER_RAD:
            self._check_directions(far)
        good = inliers(off, self._seen)
        rows, white = self._slopes(values), self._white
        white_rows, white_off = white @ rows, (white @ off[..., None])[..., 0]
        known = np.diag(self._deviation**-2.0)
        known += np.einsum("kmi,kmj->ij", white_rows[good], white_rows[good])
        stamps_s = self._path.stamps_s[good]
        alike = self._alike(known, white_rows[good], white_off[good], stamps_s)
        misfit, where = self._unfitting(values, white_rows[good], white_off[good], good)
        covariance = max(alike, misfit) * np.linalg.inv(known) + self._common()
        return self._told(values, covariance, off, good, misfit, where)

    def _unfitting(
        self, values: np.ndarray, rows: np.ndarray, off: np.ndarray, good: np.ndarray
    ) -> tuple[float, tuple[str, float, float] | None]:
        """Squares that displaced links would explain, for each of their numbers.

        And, if that is no noise, the joint at which a displaced rest of the arm explains most, with
        the displacement, m and rad.
        """
        unknowns = rows.reshape(-1, rows.shape[2])
        beside = [self._displaced(values, i, good) for i in range(1, len(self._arm.names))]
        if not beside:
            return 1.0, None
        gained = [self._gain(unknowns, one, off) for one in (np.hstack(beside), *beside)]
        noise = np.sum(off**2) / (off.size - unknowns.shape[1] - 6 * len(beside))
        misfit = float(gained[0][0] / (6.0 * len(beside) * noise))
        if misfit <= _UNFIT:
            return misfit, None
        best = max(range(1, len(gained)), key=lambda one: gained[one][0])
        turn_rad, shift_m = (float(np.linalg.norm(one)) for one in np.split(gained[best][1], 2))
        # Less is what a detector's bias looks like.
        off_m, off_rad = 0.5 * GOOD[0], GOOD[1]
        shown = shift_m > off_m or turn_rad > off_rad
        return misfit, (self._arm.names[best], shift_m, turn_rad) if shown else None

    def _gain(
        self, unknowns: np.ndarray, beside: np.ndarray, off: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Squares of residuals that further columns explain, and their values, m and rad."""
        both = np.hstack([unknowns, beside])
        size, pull = unknowns.shape[1], -both.T @ off.ravel()
        held = np.append(self._deviation, np.full(beside.shape[1], _ANYWHERE)) ** -2.0
        known = both.T @ both + np.diag(held)
        found = np.linalg.solve(known, pull)
        before = np.linalg.solve(known[:size, :size], pull[:size])
        return float(found @ pull - before @ pull[:size]), found[size:]

    def _displaced(self, values: np.ndarray, i: int, good: np.ndarray) -> np.ndarray:
        """White slopes by turns and shifts of the arm from joint i on, (k m, 6)."""
        step, now, columns = 1e-6, self._model(values), []
        for twist in step * np.eye(6):
            turn, shift, pivot = rotation_matrix(twist[:3]), twist[3:], self._points[i]
            later, other = np.arange(len(self._arm.names))[:, None] >= i, copy(self)
            other._axes = np.where(later, self._axes @ turn.T, self._axes)
            moved = (self._points - pivot) @ turn.T + pivot + shift
            other._points = np.where(later, moved, self._points)
            carried = self._carried.reshape(-1, 3) @ turn.T
            carried[0] += pivot - turn @ pivot + shift
            other._carried = carried.ravel()
            columns.append((other._model(values) - now) / step)
        return np.asarray((self._white @ np.stack(columns, axis=-1))[good].reshape(-1, 6))

    def _check_camera(self) -> None:
        """Refuse images of a camera that was moved while they were taken."""
        off, stamps_s = self._free_off[:, :3], self._path.stamps_s
        turns = np.swapaxes(cross_matrix(self._seen[:, :3] - self._middle), 1, 2)
        shifts = np.broadcast_to(np.eye(3), turns.shape)
        white = self._white[:, :3, :3]
        slopes = np.concatenate([turns, shifts], axis=2)
        rows = white @ slopes
        wanted = (white @ off[..., None])[..., 0]
        # Sums up to each image, of squares and of products: any moment is tried at once.
        square = np.cumsum(np.einsum("kij,kil->kjl", rows, rows), axis=0)
        pull = np.cumsum(np.einsum("kij,ki->kj", rows, wanted), axis=0)

        def moved(k: int) -> tuple[float, np.ndarray]:
            """Squares that a move after image k explains, and the move, rad and m."""
            before = np.linalg.solve(square[k], pull[k])
            after = np.linalg.solve(square[-1] - square[k], pull[-1] - pull[k])
            always = np.linalg.solve(square[-1], pull[-1])
            gain = before @ pull[k] + after @ (pull[-1] - pull[k]) - always @ pull[-1]
            return float(gain), after - before

        moments = np.linspace(0, len(off) - 1, _MOMENTS + 2).astype(int)[1:-1]
        best = max(moments, key=lambda k: moved(k)[0])
        gain, move = moved(best)
        displaced_m = np.linalg.norm(turns @ move[:3] + move[3:], axis=1).mean()
        noise_m = self._fit.noise_m
        if gain > _BUMPED * np.sum(wanted**2) and displaced_m > GOOD[0]:
            before = np.linalg.solve(square[best], pull[best])
            moves = before + np.outer(np.arange(len(off)) > best, move)
            rest = off - np.einsum("kij,kj->ki", slopes, moves)
            if _length(rest) > max(_EXPLAINED * noise_m, 0.5 * _length(off)):
                self._refuse_chain()
            raise CalibrationError(
                f"the camera moved, by about {1e3 * np.linalg.norm(move[3:]):.0f} mm and "
                f"{np.degrees(np.linalg.norm(move[:3])):.1f} degrees, some "
                f"{stamps_s[best] - stamps_s[0]:.0f} s after the first image: fix it, and collect "
                "again"
            )

        if _length(off) > max(_EXPLAINED * noise_m, 0.5 * USABLE[0]):
            self._refuse_chain()

    def _refuse_chain(self) -> None:
        others = [
            name
            for name, spread in zip(self._names, self._spread, strict=True)
            if name not in self._arm.names and spread > _STILL
        ]
        also = f" {', '.join(others)[:200]} moved, too, but is not among them." if others else ""
        raise CalibrationError(
            f"no arm of the joints {', '.join(self._arm.names)[:200]} moves like that.{also} Is "
            "the tip the right link, and what it carries tight?"
        )

    def _check_directions(self, far: float) -> None:
        """Refuse a URDF in which a joint turns the other way."""
        for i, name in enumerate(self._arm.names):
            signs = np.where(np.arange(len(self._arm.names)) == i, -1.0, 1.0)
            turned = replace(self._arm, axes=self._arm.axes * signs[:, None])
            other = _Calibrating(self._data, turned, self._fit, self._names, self._spread)
            values, off = other.solve(15)
            zeros = np.abs(values[self._at.zeros]).max(initial=0.0)
            if other._far(off) < max(far / _WRONG, 1.2) and zeros < _OTHER_RAD:
                raise CalibrationError(
                    f"{name} turns the other way than in the URDF: its axis is mirrored there, or "
                    "its encoder"
                )

    def _slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives of the model, (k, m, unknowns)."""
        step = 1e-6
        steps = step * np.eye(self._at.size)
        ends = ((self._model(values + one), self._model(values - one)) for one in steps)
        return np.stack([(up - down) / (2.0 * step) for up, down in ends], axis=-1)

    def _alike(self, known: np.ndarray, rows: np.ndarray, off: np.ndarray, s: np.ndarray) -> float:
        """Variance of the estimate over that by independent residuals: jackknife over blocks.

        Errors of images that are near to each other, in time and in place, are alike.
        """
        block = np.unique(np.floor(s / _BLOCK_S), return_inverse=True)[1]
        total = 0.0
        for number in range(block.max() + 1):
            some = block == number
            part = np.einsum("kmi,kmj->ij", rows[some], rows[some])
            pull = np.einsum("kmi,km->i", rows[some], off[some])
            change = np.linalg.solve(known - part, pull)
            total += change @ known @ change
        return max(1.0, total / rows.shape[2])

    def _common(self) -> np.ndarray:
        """Covariance of the unknowns by an error that all images have in common."""
        sight = self._middle / np.linalg.norm(self._middle)
        along = np.outer(sight, sight)
        ray_m, lateral_m = self._fit.ray_noise_m, self._fit.lateral_noise_m
        spread_m = float(np.linalg.norm(self._seen[:, :3].std(axis=0)))
        common = np.zeros((self._at.size, self._at.size))
        common[self._at.shift, self._at.shift] = ray_m**2 * along
        common[self._at.shift, self._at.shift] += lateral_m**2 * (np.eye(3) - along)
        common[self._at.turn, self._at.turn] = (lateral_m / spread_m) ** 2 * np.eye(3)
        return _COMMON**2 * common

    def _told(
        self,
        values: np.ndarray,
        covariance: np.ndarray,
        off: np.ndarray,
        good: np.ndarray,
        misfit: float,
        unfitting: tuple[str, float, float] | None,
    ) -> Calibration:
        at, arm, n = self._at, self._arm, len(self._arm.names)
        rotation, shift = self._camera(values)
        # The camera in the arm's frame: x_arm = R' (x_cam - shift).
        back = rotation.T
        place_m = -back @ shift
        # What small turns and shifts in the camera's frame do to it there.
        slopes = np.zeros((6, at.size))
        slopes[:3, at.shift] = slopes[3:, at.turn] = -back
        slopes[:3, at.turn] = -cross_matrix(back @ self._middle) @ back
        deviations = np.sqrt(np.diag(covariance))
        zeros, zeros_deviation = np.zeros(n), np.full(n, np.inf)
        zeros[1:-1], zeros_deviation[1:-1] = values[at.zeros], deviations[at.zeros]
        zeros_deviation[zeros_deviation > 0.5 * _ZERO_RAD] = np.inf
        carried_m, carried_rotation = self._on_tip(values)
        return Calibration(
            parent=arm.root,
            camera=self._data.feature_frame,
            rotation=back,
            translation_m=place_m,
            covariance=slopes @ covariance @ slopes.T,
            carried_m=carried_m,
            carried_rotation=carried_rotation,
            delay_s=float(values[at.delay]),
            delay_deviation_s=float(deviations[at.delay]),
            scale=float(np.exp(values[at.scale])),
            scale_deviation=float(deviations[at.scale]),
            joint_names=arm.names,
            zeros_rad=zeros,
            zeros_deviation_rad=zeros_deviation,
            residual_m=_length(off),
            focal=float(np.exp(values[at.focal])),
            focal_deviation=float(deviations[at.focal]),
            misfit=misfit,
            unfitting=unfitting,
            prismatic=arm.prismatic > 0.0,
            stamps_s=self._path.stamps_s,
            seen_m=self._seen[:, :3],
            residuals_m=off[:, :3],
            axes=self._chain(values).axes,
            points_m=self._chain(values).points_m,
            outliers=int(np.count_nonzero(~good)),
        )

    def _on_tip(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Ball or tag in the tip's frame: place, m, and rotation of a tag."""
        turn, tip_m = self._arm.tip_at(self._reference)
        carried = self._feature.displaced(
            self._carried, values[self._at.carried] * self._feature.task_scale
        )
        place_m = turn @ (carried[:3] - tip_m)
        if not isinstance(self._feature, PoseFeature):
            return place_m, None
        return place_m, turn @ self._feature.rotation(carried)
