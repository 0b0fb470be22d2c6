"""Where the camera is: the fitted chain, registered with the arm's URDF. No ROS, no clock.

A chain that was fitted to images (:mod:`fvs_estimator_node.chain_fit`) has the arm's axes as lines
in the camera's frame; the URDF has them in its root's. Their directions give the rotation from one
to the other, their places the shift. From there on robust least squares on the images find all
unknowns of :class:`~fvs_estimator_node.hand_eye_model.Unknowns` together, each with a prior. A
camera that is carried by the arm and looks at something fixed is the same with the chain read from
its other end.

How far zeros, encoders, links and lens may be off is not known before. So the result is averaged
over prior deviations of all of them, weighted by evidence (Bayesian model averaging).

A camera cannot tell the zero of the first joint from its own place, nor that of the last joint from
the place of ball or tag: both zeros count as exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from fvs_estimator_node.calibration import (
    GOOD,
    OTHER_RAD,
    Calibration,
    CalibrationError,
    Displaced,
    Remedy,
)
from fvs_estimator_node.chain_fit import (
    ChainFit,
    fit_chain,
    inliers,
    noise_by_direction,
    robust_optimum,
    whitening,
)
from fvs_estimator_node.chain_start import MAX_OFFSET_S
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.hand_eye_checks import find_move, length, ordered, refusal
from fvs_estimator_node.hand_eye_model import HandEyeModel
from fvs_estimator_node.hand_eye_start import still_fit
from fvs_ros.chain import cross_matrix
from fvs_ros.urdf import Kinematics

#: Prior deviations: of the images' delay, s; of camera and carried, from where the registration
#: puts them, m and rad.
_DELAY_S, _ANYWHERE = 0.1, 1.0


class _Sizes(NamedTuple):
    """Prior deviations of what may be off."""

    zeros_rad: float  # m for a prismatic joint
    encoders: float
    links_m: float
    scale: float
    lens: float  # of the focal length; of the distortion ten times as much


#: Those that are tried, all as likely, the widest first; the last is as good as exact. No camera's
#: scale is: where links are off, too, the images cannot tell the two apart.
_TRIED = {
    "zeros_rad": (0.05, 0.005, 5e-4, 5e-5),
    "encoders": (0.005, 5e-4, 1e-6),
    "links_m": (0.01, 0.002, 4e-4, 1e-6),
    "scale": (0.05, 0.012, 0.003),
    "lens": (0.02, 0.002, 1e-5),
}
_WIDEST, _EXACT = (_Sizes(*(some[which] for some in _TRIED.values())) for which in (0, -1))
#: A link's turn, rad, is as likely as its shift over this length, m.
_LINK_LENGTH_M = 0.5
#: Links are off if that explains the images so much better, logarithm of the likelihoods' ratio.
_SURE = 5.0
#: Blocks of images, s: residuals within one may be alike.
_BLOCK_S = 2.0
#: A detector's bias over what neighbouring images share: with less, too few of rendered images'
#: calibrations are within their 95 % ellipsoids (21 of 24 with 4, 23 with this, 14 with 1).
_COMMON = 5.0
#: Largest length of a residual over its noise, for a robust fit.
_ROBUST = 2.0
#: Of images this far from the model, as a share of how far they are apart, nothing is explained.
_UNEXPLAINED = 0.2
#: A model this many times as far from the images as a free chain is wrong.
_WRONG = 3.0
#: A delay of this share of the longest that is searched is longer.
_LATEST = 0.95
#: Linearisations about the mean.
_ROUNDS = 2


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
        values, off = one.solve()
        moved = one.find_move()
        if moved is None:
            raise refusal(given, arm)
        if moved:
            raise CalibrationError(moved)
        one.check_directions(values, off)
        if length(off) > _UNEXPLAINED * length(data.ball_m - data.ball_m.mean(axis=0)):
            raise refusal(given, arm)
        return one.told(values, carries_camera)


class _Posterior(NamedTuple):
    """The unknowns by the images and what was known before."""

    mean: np.ndarray
    covariance: np.ndarray
    #: What the images alone tell: ``square x = pull`` is the least-squares solution.
    square: np.ndarray
    pull: np.ndarray
    #: Likeliest prior deviations, and variance of a white residual.
    sizes: _Sizes
    noise: float
    #: Variance of what neighbouring images share, over that of one.
    shared: float
    #: Logarithm of the likelihood with links of that deviation, over that with exact ones.
    unlikely: float


class _Calibrating:
    """Least squares about the start that the registration gives."""

    def __init__(self, data: DataSet, arm: Kinematics, fit: ChainFit) -> None:
        self._data, self._arm, self._fit = data, arm, fit
        self._model = model = HandEyeModel(data, arm, fit)
        self._seen, self._at = model.seen, model.at
        joints = model.path.joints_and_velocities(fit.time_offset_s)[0]
        self._off = fit.chain.position(joints) - self._seen
        self._white = whitening(self._off, self._seen)

    def _deviation(self, sizes: _Sizes) -> np.ndarray:
        """Prior deviations of the unknowns."""
        at, deviation = self._at, np.full(self._at.size, _ANYWHERE)
        deviation[at.delay], deviation[at.scale] = _DELAY_S, sizes.scale
        deviation[at.focal], deviation[at.radial] = sizes.lens, 10.0 * sizes.lens
        deviation[at.zeros], deviation[at.encoders] = sizes.zeros_rad, sizes.encoders
        link = np.repeat([sizes.links_m / _LINK_LENGTH_M, sizes.links_m], 3)
        deviation[at.links] = np.resize(link, deviation[at.links].size)
        if self._arm.exact:  # a hand whose pose is measured
            for some in (at.zeros, at.encoders, at.links):
                deviation[some] = _EXACT.links_m
        return deviation

    def solve(self, evaluations: int = 50) -> tuple[np.ndarray, np.ndarray]:
        """The unknowns, with the links of the URDF, and how far the images are, m, (k, m)."""
        free = self._at.links.start
        deviation = self._deviation(_WIDEST)[:free]

        def whole(values: np.ndarray) -> np.ndarray:
            return np.append(values, np.zeros(self._at.size - free))

        def white(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            seen, slopes = self._model.seen_and_slopes(whole(values))
            off = self._white @ (seen - self._seen)[..., None]
            return off, self._white @ slopes[..., :free]

        start = np.zeros(free)
        start[self._at.delay] = self._fit.time_offset_s
        found, _ = robust_optimum(white, start, deviation, _ROBUST, evaluations)
        values = whole(found)
        off = self._model.seen_and_slopes(values)[0] - self._seen
        if length(off) < length(self._off):  # the free chain may be at a wrong optimum
            self._off, self._white = off, whitening(off, self._seen)
        return values, off

    def find_move(self) -> str | None:
        """See :func:`~fvs_estimator_node.hand_eye_checks.find_move`."""
        if self._data.still:  # too few to tell
            return ""
        return find_move(
            self._off[:, :3],
            self._seen[:, :3],
            self._white[:, :3, :3],
            self._model.path.stamps_s,
            float(np.nan_to_num(self._fit.noise_m)),  # not known of slow images
        )

    def _far(self, off: np.ndarray) -> float:
        """Distance of the typical image, over that from the free chain."""
        here, free = (
            np.median(np.linalg.norm(self._white @ one[..., None], axis=1))
            for one in (off, self._off)
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

    def told(self, values: np.ndarray, carries_camera: bool) -> Calibration:
        """The calibration about the unknowns that were solved for."""
        at, arm, model = self._at, self._arm, self._model
        for _ in range(_ROUNDS):
            seen, slopes = model.seen_and_slopes(values)
            off = seen - self._seen
            good = inliers(off, self._seen)
            if not good.any():
                raise CalibrationError("no camera explains these images: record more motion")
            rows = (self._white @ slopes)[good]
            white = (self._white @ off[..., None])[good, :, 0]
            found = self._posterior(values, white, rows, good)
            values, off = found.mean, off + slopes @ (found.mean - values)
            self._off, self._white = off, whitening(off, self._seen)
        deviations, zeros = np.sqrt(np.diag(found.covariance)), np.zeros(len(arm.names))
        zeros[1:-1] = values[at.zeros]
        rotation, shift = model.camera(values)
        carried_m, carried_rotation = model.on_tip(values)
        result = Calibration(
            arm=arm,
            camera=self._data.feature_frame,
            # x_arm = R' (x_cam - shift)
            rotation=rotation.T,
            translation_m=-rotation.T @ shift,
            covariance=self._of_camera(values, found.covariance),
            carried_m=carried_m,
            carried_rotation=carried_rotation,
            delay_s=float(values[at.delay]),
            delay_deviation_s=float(deviations[at.delay]),
            scale=float(np.exp(values[at.scale])),
            scale_deviation=float(deviations[at.scale]),
            focal=float(np.exp(values[at.focal])),
            focal_deviation=float(deviations[at.focal]),
            radial=float(values[at.radial]),
            radial_deviation=float(deviations[at.radial]),
            encoders=values[at.encoders],
            encoders_deviation=deviations[at.encoders],
            zeros_rad=zeros,
            zeros_deviation_rad=self._of_zeros(deviations, found.square, found),
            residual_m=length(off),
            stamps_s=model.path.stamps_s,
            seen_m=self._seen[:, :3],
            residuals_m=off[:, :3],
            outliers=int(np.count_nonzero(~good)),
            displaced=self._displaced(found, carries_camera),
        )
        if result.verdict[0] == "good" and np.isfinite(result.zeros_deviation_rad[1:-1]).all():
            return result
        return replace(result, remedies=tuple(self._remedies(found, rows, good)))

    # --- how well the unknowns are known ---

    def _posterior(
        self, values: np.ndarray, off: np.ndarray, rows: np.ndarray, good: np.ndarray
    ) -> _Posterior:
        """Mean over all sizes of zeros and links, by white residuals (k, m) and their slopes."""
        square = _square(rows)
        pull = square @ values - np.einsum("kmi,km->i", rows, off)
        weak, exact = (
            square + np.diag(self._deviation(sizes) ** -2.0)
            for sizes in (_WIDEST, _EXACT._replace(zeros_rad=_WIDEST.zeros_rad))
        )
        rest = off + rows @ (np.linalg.solve(weak, pull) - values)
        pulls = np.einsum("kmi,km->ki", rows, rest)
        noise, shared = self._noise(exact, square, pulls, self._model.path.stamps_s[good])
        # Of few images the unknowns take a part of the noise.
        numbers = len(rest) * self._data.kind.size
        spare = numbers - float(np.trace(np.linalg.solve(weak, square)))
        noise = max(1.0, noise * numbers / max(spare, 1.0))
        tried = [_Sizes(*some) for some in product(*_TRIED.values())]
        precisions = noise * np.array([self._deviation(sizes) for sizes in tried]) ** -2.0
        known = square + precisions[:, None] * np.eye(len(square))
        lower = np.linalg.cholesky(known)
        halves = np.linalg.solve(lower, np.broadcast_to(pull[:, None], (len(tried), len(pull), 1)))
        evidence = (
            0.5 * np.sum(halves**2, axis=(1, 2)) / noise
            + 0.5 * np.log(precisions).sum(axis=1)
            - np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        )
        weights = np.exp(evidence - np.max(evidence))
        some = weights > 1e-3
        inverse, weights = np.linalg.inv(known[some]), weights[some] / weights[some].sum()
        means = inverse @ pull
        mean = weights @ means
        spread = (means - mean) * np.sqrt(weights)[:, None]
        covariance = noise * np.einsum("s,sij->ij", weights, inverse) + spread.T @ spread
        links = np.array([sizes.links_m for sizes in tried])
        exact_links = evidence[links == _EXACT.links_m].max()
        likeliest = int(np.argmax(evidence))
        return _Posterior(
            mean=mean,
            covariance=covariance + self._common(self._seen, shared),
            square=square,
            pull=pull,
            sizes=tried[likeliest],
            noise=noise,
            shared=shared,
            unlikely=float(evidence[likeliest] - exact_links),
        )

    def _noise(
        self, known: np.ndarray, square: np.ndarray, pulls: np.ndarray, stamps_s: np.ndarray
    ) -> tuple[float, float]:
        """Variance of the estimate over that by white residuals, and of what neighbours share.

        Residuals of images that are near to each other are alike: sums over blocks of time scatter
        more than those of single images. Takes the pulls of all images, (k, unknowns).
        """
        blocks = np.unique(np.floor(stamps_s / _BLOCK_S), return_index=True)[1]
        count = np.trace(np.linalg.solve(known, square))
        by_block, by_image = (
            float(np.trace(np.linalg.solve(known, some.T @ some)) / count)
            for some in (np.add.reduceat(pulls, np.sort(blocks)), pulls)
        )
        shared = max(0.0, by_block - by_image) * len(blocks) / len(pulls)
        return by_block, shared

    def _common(self, seen: np.ndarray, shared: float) -> np.ndarray:
        """Covariance of the unknowns by an error that all images have in common.

        Of a detector's bias no residual tells. It counts as what neighbouring images share.
        """
        middle = self._model.middle
        sight = middle / np.linalg.norm(middle)
        along = np.outer(sight, sight)
        ray_m, lateral_m = noise_by_direction(self._off[:, :3], self._seen)
        spread_m = float(np.linalg.norm(seen[:, :3].std(axis=0)))
        common = np.zeros((self._at.size, self._at.size))
        common[self._at.shift, self._at.shift] = ray_m**2 * along
        common[self._at.shift, self._at.shift] += lateral_m**2 * (np.eye(3) - along)
        common[self._at.turn, self._at.turn] = (lateral_m / spread_m) ** 2 * np.eye(3)
        return _COMMON**2 * shared * common

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
        prior = self._deviation(found.sizes._replace(zeros_rad=_WIDEST.zeros_rad)) ** -2.0
        by_images = np.sqrt(np.diag(_inverse(square / found.noise + np.diag(prior))))
        told = np.full(len(self._arm.names), np.inf)
        unsure = by_images[self._at.zeros] > 0.5 * _WIDEST.zeros_rad
        told[1:-1] = np.where(unsure, np.inf, deviations[self._at.zeros])
        return told

    def _displaced(self, found: _Posterior, carries_camera: bool) -> Displaced | None:
        """The joints at which a displaced rest of the arm explains most, if links are off."""
        if found.unlikely < _SURE:
            return None
        free, square, pull = self._at.links.start, found.square, found.pull
        prior = found.noise * self._deviation(_WIDEST) ** -2.0
        # The URDF places each joint on the one before it: read from the tip, the joint after it.
        names = self._arm.names[:-1] if carries_camera else self._arm.names[1:]
        tried = []
        for i, name in enumerate(names):
            some = np.append(np.arange(free), free + 6 * i + np.arange(6))
            one = np.linalg.solve(square[np.ix_(some, some)] + np.diag(prior[some]), pull[some])
            turn_rad, shift_m = (float(np.linalg.norm(part)) for part in np.split(one[free:], 2))
            tried.append((one @ pull[some] / found.noise, Displaced(name, shift_m, turn_rad)))
        most, best = max(tried, key=lambda one: one[0])
        alike = [one.joint for gain, one in tried if gain > most - 2.0 * _SURE]
        best = best._replace(joint=" or ".join(alike[::-1] if carries_camera else alike))
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
        precision = np.diag(self._deviation(found.sizes) ** -2.0)
        for words, wider in (*tried, longer, ("move all joints twice as far", np.full(n, 2.0))):
            some = 2.0 * rows
            if words != longer[0]:
                some = (self._white @ self._model.seen_and_slopes(found.mean, wider)[1])[good]
            square = _square(some)
            covariance = _inverse(square / found.noise + precision)
            covariance += self._common(
                self._model.seen_and_slopes(found.mean, wider)[0], found.shared
            )
            of_camera = self._of_camera(found.mean, covariance)
            place_m, turn_rad = (np.sqrt(np.trace(of_camera[k : k + 3, k : k + 3])) for k in (0, 3))
            zeros = self._of_zeros(np.sqrt(np.diag(covariance)), square, found)
            yield Remedy(words, float(place_m), float(turn_rad), zeros)


def _square(rows: np.ndarray) -> np.ndarray:
    """Information of white rows, (k, m, unknowns); no less than rounding, to stay positive."""
    flat = rows.reshape(-1, rows.shape[2])
    square = flat.T @ flat
    return np.asarray(square + 1e-14 * square.diagonal().max() * np.eye(len(square)))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive matrix of very different units."""
    unit = np.diag(matrix) ** -0.5
    return np.asarray(np.linalg.inv(matrix * np.outer(unit, unit)) * np.outer(unit, unit))


def _times(factor: float) -> str:
    return "twice" if factor < 2.5 else f"{factor:.0f} times"
