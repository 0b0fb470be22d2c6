"""Where the camera is: the fitted chain, registered with the arm's URDF. No ROS, no clock.

A chain that was fitted to images (:mod:`fvs_estimator_node.chain_fit`) has the arm's axes as lines
in the camera's frame; the URDF has them in its root's. The turn that takes one to the other comes
from their directions, the shift from their places. From there on robust least squares on the images
find camera, place of ball or tag on the tip, delay of the images, scale of the camera and zeros of
the joints together. A camera that is carried by the arm and looks at something fixed is the same
with the chain read from its other end.

How far zeros and links are from the URDF is not known before. So the result is the mean over many
such sizes, weighted by how well each explains the images (Bayesian model averaging): with an exact
URDF zeros and links hold still and the camera is known well, with a poor one its covariance grows.

A camera cannot tell the zero of the first joint from its own place, nor that of the last joint from
the place of ball or tag: both zeros count as exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from fvs_estimator_node.calibration import (
    GOOD,
    OTHER_RAD,
    Calibration,
    CalibrationError,
    Displaced,
    Remedy,
)
from fvs_estimator_node.chain_fit import ChainFit, fit_chain, inliers, whitening
from fvs_estimator_node.chain_start import MAX_OFFSET_S
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.hand_eye_checks import find_move, length, ordered, refusal
from fvs_estimator_node.hand_eye_model import HandEyeModel
from fvs_estimator_node.hand_eye_start import still_fit
from fvs_ros.chain import cross_matrix
from fvs_ros.urdf import Kinematics

#: Prior deviations: of the images' delay, s; of all else, from where the registration puts it, m
#: and rad; of the camera's focal length over that of its scale.
_DELAY_S, _ANYWHERE, _FOCAL = 0.1, 1.0, 0.1
#: Those of zeros, rad (m), links, m, and the camera's scale that are tried, all as likely, the
#: widest first. No camera's scale is better than the last: where links are off, too, the images
#: cannot tell the two apart. They tell a zero that they know better than half the first.
_ZEROS_RAD, _LINKS_M = np.geomspace(0.05, 2e-5, 9), np.geomspace(0.02, 2e-6, 9)
_SCALES = np.geomspace(0.05, 0.003, 3)
_WIDEST = _ZEROS_RAD[0], _LINKS_M[0], _SCALES[0]
#: That of zeros and links, rad and m, of a hand whose pose is measured.
_EXACT = 1e-6
#: A link's turn, rad, is as likely as its shift over this length, m.
_LINK_LENGTH_M = 0.5
#: Links are off if that explains the images so much better, logarithm of the likelihoods' ratio.
_SURE = 5.0
#: Blocks of images, s: residuals within one may be alike. Of an error that all images share, such
#: as a detector's bias, no residual tells; it counts as this share of an image's noise.
_BLOCK_S, _COMMON = 2.0, 0.3
#: Largest length of a residual over its noise, for a robust fit.
_ROBUST = 2.0
#: Of images this far from the model, as a share of how far they are apart, nothing is explained.
_UNEXPLAINED = 0.2
#: A model this many times as far from the images as a free chain is wrong.
_WRONG = 3.0
#: A delay of this share of the longest that is searched is longer.
_LATEST = 0.95
#: The free chain is at a wrong optimum if the URDF's is this much nearer to the images.
_BETTER = 0.7


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
    ValueError
        If there are too few images, joints do not fit together or did not move, or nothing fits
        (a ``CalibrationError``).
    """
    say = progress or (lambda words: None)
    arm, given = arm.reversed() if carries_camera else arm, data
    data = ordered(data, arm)
    fit = still_fit(data, arm) if data.still else fit_chain(data, say)
    if abs(fit.time_offset_s) > _LATEST * MAX_OFFSET_S:
        raise CalibrationError(
            f"the images are stamped {fit.time_offset_s:+.2f} s late, or more: correct their stamps"
        )
    say("registering the chain with the URDF")
    with threadpool_limits(1):
        one = _Calibrating(data, arm, fit)
        values, off = one.solve_twice()
        moved = one.find_move()
        if moved is None:
            raise refusal(given, arm)
        if moved:
            raise CalibrationError(moved)
        one.check_directions(values, off)
        if length(off) > _UNEXPLAINED * length(data.ball_m - data.ball_m.mean(axis=0)):
            raise refusal(given, arm)
        return one.told(values, off)


class _Posterior(NamedTuple):
    """The unknowns by the images and what was known before."""

    mean: np.ndarray
    covariance: np.ndarray
    #: What the images alone tell: ``square x = pull`` is the least-squares solution.
    square: np.ndarray
    pull: np.ndarray
    #: Likeliest deviations of zeros, rad (m), links, m, and scale; variance of a white residual.
    sizes: tuple[float, float, float]
    noise: float
    #: Logarithm of the likelihood with links of that deviation, over that with exact ones.
    unlikely: float


class _Calibrating:
    """Least squares about the start that the registration gives."""

    def __init__(self, data: DataSet, arm: Kinematics, fit: ChainFit) -> None:
        self._data, self._arm, self._fit = data, arm, fit
        self._model = model = HandEyeModel(data, arm, fit)
        self._seen, self._at = model.seen, model.at
        joints = model.path.joints_and_velocities(fit.time_offset_s)[0]
        self._free_off = fit.chain.position(joints) - self._seen
        self._white = whitening(self._free_off, self._seen)

    def _deviation(self, zero_rad: float, link_m: float, scale: float) -> np.ndarray:
        """Prior deviations of the unknowns."""
        at, deviation = self._at, np.full(self._at.size, _ANYWHERE)
        deviation[at.delay], deviation[at.scale] = _DELAY_S, scale
        deviation[at.focal] = _FOCAL * scale
        deviation[at.zeros] = zero_rad
        turn, shift = [link_m / _LINK_LENGTH_M] * 3, [link_m] * 3
        deviation[at.links] = np.resize([*turn, *shift], deviation[at.links].size)
        if self._arm.exact:
            deviation[at.zeros] = deviation[at.links] = _EXACT
        return deviation

    def solve(
        self, evaluations: int = 50, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The unknowns, with the links of the URDF, and how far the images are, m, (k, m)."""
        free = self._at.links.start
        deviation = self._deviation(*_WIDEST)[:free]

        def whole(values: np.ndarray) -> np.ndarray:
            return np.append(values, np.zeros(self._at.size - free))

        def residuals(values: np.ndarray) -> np.ndarray:
            off = self._model.features(whole(values)) - self._seen
            return np.append(self._white @ off[..., None], values / deviation)

        if start is None:
            start = np.zeros(free)
            start[self._at.delay] = self._fit.time_offset_s
        found = least_squares(
            residuals,
            start[:free],
            loss="soft_l1",
            f_scale=_ROBUST,
            x_scale="jac",
            max_nfev=evaluations,
        )
        values = whole(found.x)
        return values, self._model.features(values) - self._seen

    def solve_twice(self) -> tuple[np.ndarray, np.ndarray]:
        """The same, where need be with the noise that it shows."""
        values, off = self.solve()
        if length(off) < _BETTER * length(self._free_off):
            # In much noise the free chain may have one axis on the wrong side.
            self._free_off, self._white = off, whitening(off, self._seen)
            values, off = self.solve(start=values)
        return values, off

    def find_move(self) -> str | None:
        """See :func:`~fvs_estimator_node.hand_eye_checks.find_move`."""
        if self._data.still:  # too few to tell
            return ""
        return find_move(
            self._free_off[:, :3],
            self._seen[:, :3],
            self._white[:, :3, :3],
            self._model.path.stamps_s,
            float(np.nan_to_num(self._fit.noise_m)),  # not known of slow images
        )

    def _far(self, off: np.ndarray) -> float:
        """Distance of the typical image, over that from the free chain."""
        here, free = (
            np.median(np.linalg.norm(self._white @ one[..., None], axis=1))
            for one in (off, self._free_off)
        )
        return float(here / free)

    def _turned(self, values: np.ndarray) -> bool:
        """Whether a joint's zero is so far off that it is another, or turns the other way."""
        revolute = self._arm.prismatic[1:-1] == 0.0
        return bool(np.abs(values[self._at.zeros][revolute]).max(initial=0.0) > OTHER_RAD)

    def check_directions(self, values: np.ndarray, off: np.ndarray) -> None:
        """Refuse a URDF in which a joint turns the other way."""
        far = self._far(off)
        if far <= _WRONG and not self._turned(values):
            return
        for i, name in enumerate(self._arm.names):
            signs = np.where(np.arange(len(self._arm.names)) == i, -1.0, 1.0)
            turned = replace(self._arm, axes=self._arm.axes * signs[:, None])
            other = _Calibrating(self._data, turned, self._fit)
            found, other_off = other.solve(15)
            if other._far(other_off) < max(far / _WRONG, 1.2) and not other._turned(found):
                raise CalibrationError(
                    f"{name} turns the other way than in the URDF: its axis is mirrored there, or "
                    "its encoder"
                )

    def told(self, values: np.ndarray, off: np.ndarray) -> Calibration:
        """The calibration about the unknowns that were solved for."""
        at, arm, model = self._at, self._arm, self._model
        good = inliers(off, self._seen)
        rows = (self._white @ model.slopes(values))[good]
        found = self._posterior(values, (self._white @ off[..., None])[good, :, 0], rows, good)
        off = model.features(found.mean) - self._seen
        deviations, zeros = np.sqrt(np.diag(found.covariance)), np.zeros(len(arm.names))
        zeros[1:-1] = found.mean[at.zeros]
        rotation, shift = model.camera(found.mean)
        carried_m, carried_rotation = model.on_tip(found.mean)
        result = Calibration(
            arm=arm,
            camera=self._data.feature_frame,
            # x_arm = R' (x_cam - shift)
            rotation=rotation.T,
            translation_m=-rotation.T @ shift,
            covariance=self._of_camera(found.mean, found.covariance),
            carried_m=carried_m,
            carried_rotation=carried_rotation,
            delay_s=float(found.mean[at.delay]),
            delay_deviation_s=float(deviations[at.delay]),
            scale=float(np.exp(found.mean[at.scale])),
            scale_deviation=float(deviations[at.scale]),
            focal=float(np.exp(found.mean[at.focal])),
            focal_deviation=float(deviations[at.focal]),
            zeros_rad=zeros,
            zeros_deviation_rad=self._of_zeros(deviations, found.square, found),
            residual_m=length(off),
            stamps_s=model.path.stamps_s,
            seen_m=self._seen[:, :3],
            residuals_m=off[:, :3],
            outliers=int(np.count_nonzero(~good)),
            displaced=self._displaced(found),
        )
        if result.verdict[0] == "good" and np.isfinite(result.zeros_deviation_rad[1:-1]).all():
            return result
        return replace(result, remedies=tuple(self._remedies(found, rows, good)))

    # --- how well the unknowns are known ---

    def _posterior(
        self, values: np.ndarray, off: np.ndarray, rows: np.ndarray, good: np.ndarray
    ) -> _Posterior:
        """Mean over all sizes of zeros and links, by white residuals (k, m) and their slopes."""
        square = np.einsum("kmi,kmj->ij", rows, rows)
        pull = square @ values - np.einsum("kmi,km->i", rows, off)
        weak = np.diag(self._deviation(*_WIDEST) ** -2.0)
        best = np.linalg.solve(square + weak, pull)
        rest = off + rows @ (best - values)
        noise = self._noise(square + weak, rows, rest, self._model.path.stamps_s[good])
        sizes, means, spreads, evidence = [*product(_ZEROS_RAD, _LINKS_M, _SCALES)], [], [], []
        for size in sizes:
            precision = noise * self._deviation(*size) ** -2.0
            known = square + np.diag(precision)
            means.append(np.linalg.solve(known, pull))
            spreads.append(noise * _inverse(known))
            evidence.append(
                0.5 * means[-1] @ pull / noise
                + 0.5 * np.log(precision).sum()
                - 0.5 * np.linalg.slogdet(known)[1]
            )
        weights = np.exp(evidence - np.max(evidence))
        mean = np.average(means, axis=0, weights=weights)
        covariance = np.average(
            np.array(spreads) + np.einsum("si,sj->sij", means - mean, means - mean),
            axis=0,
            weights=weights,
        )
        of_links = np.reshape(evidence, (len(_ZEROS_RAD), len(_LINKS_M), -1)).max(axis=(0, 2))
        return _Posterior(
            mean,
            covariance + self._common(self._seen),
            square,
            pull,
            sizes[int(np.argmax(evidence))],
            noise,
            float(of_links.max() - of_links[-1]),
        )

    def _noise(
        self, known: np.ndarray, rows: np.ndarray, off: np.ndarray, stamps_s: np.ndarray
    ) -> float:
        """Variance of the estimate over that by independent residuals: jackknife over blocks.

        Errors of images that are near to each other, in time and in place, are alike.
        """
        block = np.unique(np.floor(stamps_s / _BLOCK_S), return_inverse=True)[1]
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
        middle = self._model.middle
        sight = middle / np.linalg.norm(middle)
        along = np.outer(sight, sight)
        ray_m, lateral_m = self._fit.ray_noise_m, self._fit.lateral_noise_m
        spread_m = float(np.linalg.norm(seen[:, :3].std(axis=0)))
        common = np.zeros((self._at.size, self._at.size))
        common[self._at.shift, self._at.shift] = ray_m**2 * along
        common[self._at.shift, self._at.shift] += lateral_m**2 * (np.eye(3) - along)
        common[self._at.turn, self._at.turn] = (lateral_m / spread_m) ** 2 * np.eye(3)
        return _COMMON**2 * common

    def _of_camera(self, values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Covariance of the camera's place and turn in the arm's frame, from the unknowns'."""
        at, back = self._at, self._model.camera(values)[0].T
        slopes = np.zeros((6, at.size))
        slopes[:3, at.shift] = slopes[3:, at.turn] = -back
        slopes[:3, at.turn] = -cross_matrix(back @ self._model.middle) @ back
        return np.asarray(slopes @ covariance @ slopes.T)

    def _of_zeros(
        self, deviations: np.ndarray, square: np.ndarray, found: _Posterior
    ) -> np.ndarray:
        """Deviations of the joints' zeros, rad (m); infinite where the images tell nothing."""
        prior = self._deviation(_ZEROS_RAD[0], *found.sizes[1:]) ** -2.0
        by_images = np.sqrt(np.diag(_inverse(square / found.noise + np.diag(prior))))
        told = np.full(len(self._arm.names), np.inf)
        unsure = by_images[self._at.zeros] > 0.5 * _ZEROS_RAD[0]
        told[1:-1] = np.where(unsure, np.inf, deviations[self._at.zeros])
        return told

    def _displaced(self, found: _Posterior) -> Displaced | None:
        """The joint at which a displaced rest of the arm explains most, if links are off."""
        if found.unlikely < _SURE:
            return None
        free, square, pull = self._at.links.start, found.square, found.pull
        prior = found.noise * self._deviation(*_WIDEST) ** -2.0
        tried = []
        for i, name in enumerate(self._arm.names[1:]):
            some = np.append(np.arange(free), free + 6 * i + np.arange(6))
            one = np.linalg.solve(square[np.ix_(some, some)] + np.diag(prior[some]), pull[some])
            turn_rad, shift_m = (float(np.linalg.norm(part)) for part in np.split(one[free:], 2))
            tried.append((one @ pull[some], Displaced(name, shift_m, turn_rad)))
        best = max(tried, key=lambda one: one[0])[1]
        # Less is what a detector's bias looks like.
        return best if best.shift_m > 0.5 * GOOD[0] or best.turn_rad > GOOD[1] else None

    def _remedies(self, found: _Posterior, rows: np.ndarray, good: np.ndarray) -> Iterator[Remedy]:
        """What other motion would have told: the least change first."""
        arm, n = self._arm, len(self._arm.names)
        spread = self._model.path.joints_and_velocities(0.0)[0].std(axis=0)
        alike = arm.prismatic[:, None] == arm.prismatic
        most = np.where(alike, spread, 0.0).max(axis=1)
        moved = np.flatnonzero(spread)  # of still poses a joint may be at rest
        further = np.maximum(2.0, most[moved] / spread[moved])  # as far as the others, at least
        tried = [
            (
                f"move {arm.names[i]} {_times(factor)} as far",
                np.where(np.arange(n) == i, factor, 1.0),
            )
            for i, factor in zip(moved, further, strict=True)
        ]
        longer = ("move four times as long", np.ones(n))
        precision = np.diag(self._deviation(*found.sizes) ** -2.0)
        for words, wider in (*tried, longer, ("move all joints twice as far", np.full(n, 2.0))):
            some = 2.0 * rows
            if words != longer[0]:
                some = (self._white @ self._model.slopes(found.mean, wider))[good]
            square = np.einsum("kmi,kmj->ij", some, some)
            covariance = _inverse(square / found.noise + precision)
            covariance += self._common(self._model.features(found.mean, wider))
            of_camera = self._of_camera(found.mean, covariance)
            place_m, turn_rad = (np.sqrt(np.trace(of_camera[k : k + 3, k : k + 3])) for k in (0, 3))
            zeros = self._of_zeros(np.sqrt(np.diag(covariance)), square, found)
            yield Remedy(words, float(place_m), float(turn_rad), zeros)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive matrix of very different units."""
    unit = np.diag(matrix) ** -0.5
    return np.asarray(np.linalg.inv(matrix * np.outer(unit, unit)) * np.outer(unit, unit))


def _times(factor: float) -> str:
    return "twice" if factor < 2.5 else f"{factor:.0f} times"
