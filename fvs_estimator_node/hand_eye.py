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

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from fvs_estimator_node.calibration import (
    GOOD,
    OTHER_RAD,
    USABLE,
    Calibration,
    CalibrationError,
    Remedy,
)
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
#: Blocks of images, s: residuals within one may be alike. Of an error that all images share, such
#: as a detector's bias, no residual tells; it counts as this share of an image's noise.
_BLOCK_S, _COMMON = 2.0, 0.3
#: Sine of the angle below which two axes are parallel.
_PARALLEL = 0.05
#: Largest length of a residual over its noise, for a robust fit.
_ROBUST = 2.0
#: With this misfit the URDF does not fit. A model this many times as far from the images as a free
#: chain is wrong.
_UNFIT, _WRONG = 10.0, 3.0
#: Images are explained if they are nearer than this many times their noise.
_EXPLAINED = 1.6
#: The free chain is at a wrong optimum if the URDF's is this much nearer to the images.
_BETTER = 0.7
#: Moments at which the camera may have been moved, and share of the squared residuals that this
#: must explain.
_MOMENTS, _BUMPED = 40, 0.2


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
        self._feature, self._wider = data.servoed, np.ones(len(arm.names))
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
        joints += (self._wider - 1.0) * (joints - joints.mean(axis=0))
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
        if far > _WRONG or np.abs(values[self._at.zeros]).max(initial=0.0) > OTHER_RAD:
            self._check_directions(far)
        good = inliers(off, self._seen)
        rows, white = self._slopes(values), self._white
        white_rows, white_off = white @ rows, (white @ off[..., None])[..., 0]
        known = np.diag(self._deviation**-2.0)
        known += np.einsum("kmi,kmj->ij", white_rows[good], white_rows[good])
        stamps_s = self._path.stamps_s[good]
        alike = self._alike(known, white_rows[good], white_off[good], stamps_s)
        misfit, where = self._unfitting(values, white_rows[good], white_off[good], good)
        factor = max(alike, misfit)
        covariance = factor * np.linalg.inv(known) + self._common(self._seen)
        found = self._told(values, covariance, off, good, misfit, where)
        return replace(found, remedies=tuple(self._remedies(values, white_rows, good, factor)))

    def _remedies(
        self, values: np.ndarray, rows: np.ndarray, good: np.ndarray, factor: float
    ) -> Iterator[Remedy]:
        """What other motion would have told: the least change first."""
        n, spread = len(self._arm.names), self._path.joints_and_velocities(0.0)[0].std(axis=0)
        further = np.maximum(2.0, spread.max() / spread)  # as far as the others, at least
        tried = [
            (
                f"move {name} {further[i]:.0f} times as far",
                np.where(np.arange(n) == i, further, 1.0),
            )
            for i, name in enumerate(self._arm.names)
        ]
        longer = ("move four times as long", np.ones(n))
        for words, wider in (*tried, longer, ("move all joints twice as far", np.full(n, 2.0))):
            other = copy(self)
            other._wider = wider
            some = 2.0 * rows if words == longer[0] else self._white @ other._slopes(values)
            known = np.diag(self._deviation**-2.0)
            known += np.einsum("kmi,kmj->ij", some[good], some[good])
            covariance = factor * np.linalg.inv(known) + self._common(other._model(values))
            of_camera = self._of_camera(values, covariance)
            place_m, turn_rad = (np.sqrt(np.trace(of_camera[k : k + 3, k : k + 3])) for k in (0, 3))
            yield Remedy(words, float(place_m), float(turn_rad), self._of_zeros(covariance))

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
            if other._far(off) < max(far / _WRONG, 1.2) and zeros < OTHER_RAD:
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

    def _common(self, seen: np.ndarray) -> np.ndarray:
        """Covariance of the unknowns by an error that all images have in common."""
        sight = self._middle / np.linalg.norm(self._middle)
        along = np.outer(sight, sight)
        ray_m, lateral_m = self._fit.ray_noise_m, self._fit.lateral_noise_m
        spread_m = float(np.linalg.norm(seen[:, :3].std(axis=0)))
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
        deviations, zeros = np.sqrt(np.diag(covariance)), np.zeros(n)
        zeros[1:-1] = values[at.zeros]
        carried_m, carried_rotation = self._on_tip(values)
        return Calibration(
            arm=arm,
            camera=self._data.feature_frame,
            # x_arm = R' (x_cam - shift)
            rotation=rotation.T,
            translation_m=-rotation.T @ shift,
            covariance=self._of_camera(values, covariance),
            carried_m=carried_m,
            carried_rotation=carried_rotation,
            delay_s=float(values[at.delay]),
            delay_deviation_s=float(deviations[at.delay]),
            scale=float(np.exp(values[at.scale])),
            scale_deviation=float(deviations[at.scale]),
            zeros_rad=zeros,
            zeros_deviation_rad=self._of_zeros(covariance),
            residual_m=_length(off),
            focal=float(np.exp(values[at.focal])),
            focal_deviation=float(deviations[at.focal]),
            misfit=misfit,
            unfitting=unfitting,
            stamps_s=self._path.stamps_s,
            seen_m=self._seen[:, :3],
            residuals_m=off[:, :3],
            outliers=int(np.count_nonzero(~good)),
        )

    def _of_camera(self, values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Covariance of the camera's place and turn in the arm's frame, from the unknowns'."""
        at, back = self._at, self._camera(values)[0].T
        slopes = np.zeros((6, at.size))
        slopes[:3, at.shift] = slopes[3:, at.turn] = -back
        slopes[:3, at.turn] = -cross_matrix(back @ self._middle) @ back
        return np.asarray(slopes @ covariance @ slopes.T)

    def _of_zeros(self, covariance: np.ndarray) -> np.ndarray:
        """Deviations of the joints' zeros, rad (m); infinite where the images tell nothing."""
        some = np.sqrt(np.diag(covariance))[self._at.zeros]
        deviations = np.full(len(self._arm.names), np.inf)
        deviations[1:-1] = np.where(some > 0.5 * _ZERO_RAD, np.inf, some)
        return deviations

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
