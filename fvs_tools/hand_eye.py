"""Where the camera is in an arm's frame, from images of a ball or tag and the arm's URDF.

A camera that the arm carries, before a target at rest, is the same problem with the arm read from
its tip. Linear least squares give the start, robust least squares an optimum for the URDF's links,
and two linearisations there the normal distribution of all
:class:`~fvs_tools.hand_eye_model.Unknowns`. How far links, lens, joints and scale are off is not
known before: the result is averaged over several deviations of them, weighted by evidence.

A camera cannot tell the zero of the first joint from its own pose, nor that of the last joint from
the target's: both zeros count as exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_fit import inliers, whitening
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import MAX_OFFSET_S, Path
from fvs_tools.hand_eye_model import HandEyeModel, Unknowns, registration
from fvs_tools.kinematics import Kinematics

#: Prior standard deviations, in the units of the unknowns; of links the largest.
_PRIOR = Unknowns(*np.array([1.0, 1.0, 0.1, 0.02, 0.02, 0.2, 0.05, 0.005, 0.01]))
#: Shares of it by which links, and what else is not free, may be off, all as likely: links by
#: 10 mm to 10 um. With coarser steps, more runs leave their 95 % ellipsoid.
_LINK_SHARES, _OTHER_SHARES = np.logspace(0.0, -3.0, 13), np.logspace(0.0, -2.0, 5)
#: Deviation of what counts as exact.
_EXACT = 1e-6
#: Number of images in the search.
_SEARCHED = 300
#: Noise above which a residual counts less, and evaluations of the search.
_ROBUST, _EVALUATIONS = 2.0, 50
#: Linearisations.
_ROUNDS = 2
#: Errors of images within such a block may be alike, s.
_BLOCK_S = 2.0
#: Share of that common variance that all images have in common: a detector's bias.
_BIAS = 0.25


@dataclass(frozen=True)
class Estimate:
    """A camera's pose, and what else the images tell."""

    model: HandEyeModel  #: of the data; its arm is read from the tip, if that carries the camera
    values: np.ndarray  #: the unknowns of the model, (p,)
    deviation: Unknowns  #: their standard deviations
    #: Of the camera's position, m, and of the rotation vector that turns it, rad, in the frame of
    #: the root, (6, 6).
    covariance: np.ndarray
    residual_m: np.ndarray  #: the model's points less those of the images, m, (k, 3)
    outliers: int  #: images further than six standard deviations from the model
    #: Logarithm of the likelihood with other links than the URDF's, over that with the URDF's.
    links_evidence: float

    @property
    def mean(self) -> Unknowns:
        """What is off."""
        return self.model.unknowns(self.values)

    @property
    def base_from_camera(self) -> np.ndarray:
        """The camera's pose in the frame of the arm's root, m, (4, 4)."""
        return self.model.poses(self.mean)[0]

    @property
    def target(self) -> np.ndarray:
        """The target as it would be measured in the frame of the arm's tip, (m,)."""
        arm = self.model.arm
        vectors = self.model.poses(self.mean)[1].reshape(-1, 3).copy()
        vectors[0] -= arm.tip_m
        return np.asarray((vectors @ arm.tip_rotation).ravel())

    @property
    def deviation_m(self) -> float:
        """Standard deviation of the camera's position, m."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def deviation_rad(self) -> float:
        """Standard deviation of the camera's rotation, rad."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def median_residual_m(self) -> float:
        """Median distance of the images from the model, m."""
        return float(np.median(np.linalg.norm(self.residual_m, axis=1)))


@threadpool_limits.wrap(limits=1)
def solve(data: DataSet, arm: Kinematics) -> Estimate:
    """The camera in the frame of the arm's root; the data have its joints in its order."""
    path = Path(data)
    joints = path.joints_and_velocities(0.0)[0]
    model = HandEyeModel(data, path, arm, *registration(arm, joints, data.z[path.indices]))
    values = _optimum(model)
    unknowns = model.unknowns(values)
    model = HandEyeModel(data, path, arm, *model.poses(unknowns))
    values[: model.sizes[0] + model.sizes[1]] = 0.0
    for _ in range(_ROUNDS):
        values, covariance, good, evidence = _posterior(model, values)
    deviation = model.unknowns(np.sqrt(np.diag(covariance)))
    deviation.zeros[[0, -1]] = np.inf
    if data.still:
        deviation.delay_s[:] = np.inf
    return Estimate(
        model=model,
        values=values,
        deviation=deviation,
        covariance=covariance[:6, :6],
        residual_m=(model.features(values) - model.measured)[:, :3],
        outliers=int(np.count_nonzero(~good)),
        links_evidence=evidence,
    )


def _deviations(model: HandEyeModel, links: float = 1.0, others: float = 1.0) -> np.ndarray:
    """Of all unknowns, (p,), with shares of those of links and of what else is not free."""
    shares = np.array([1.0] * 3 + [others] * 5 + [links])
    deviation = np.repeat(shares * np.array(_PRIOR), model.sizes)
    parts = model.unknowns(deviation)
    parts.zeros[[0, -1]] = _EXACT
    if model.arm.exact:
        for part in parts.zeros, parts.encoders, parts.links:
            part[:] = _EXACT
    return deviation


def _optimum(model: HandEyeModel) -> np.ndarray:
    """Robust optimum with the URDF's links."""
    images = np.unique(np.linspace(0, len(model.measured) - 1, _SEARCHED).astype(int))
    measured = model.measured[images]
    start = np.zeros(sum(model.sizes))
    white = whitening(model.features(start, images) - measured, measured)
    deviation = _deviations(model, links=_EXACT)
    limit = 10.0 * deviation
    model.unknowns(limit).delay_s[:] = MAX_OFFSET_S

    def residuals(values: np.ndarray) -> np.ndarray:
        errors = model.features(values, images) - measured
        return np.append(white @ errors[..., None], values / deviation)

    def slopes(values: np.ndarray) -> np.ndarray:
        rows = white @ model.slopes(values, images)
        return np.vstack([rows.reshape(-1, start.size), np.diag(1.0 / deviation)])

    return least_squares(
        residuals,
        start,
        slopes,
        bounds=(-limit, limit),
        x_scale=deviation,
        loss="soft_l1",
        f_scale=_ROBUST,
        ftol=1e-6,
        max_nfev=_EVALUATIONS,
    ).x


def _posterior(
    model: HandEyeModel, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Mean and covariance of the unknowns, linearised at some; inliers; evidence for links.

    One normal distribution for each size of the errors, weighted by evidence.
    """
    errors = model.features(values) - model.measured
    good = inliers(errors, model.measured)
    white = whitening(errors, model.measured)[good]
    rows = white @ model.slopes(values)[good]  # (k, m, p)
    wanted = rows @ values - (white @ errors[good][..., None])[..., 0]
    equations = np.column_stack([rows.reshape(-1, values.size), wanted.ravel()])
    # With the same sums of squares; in mode "r" the result is one array, whatever its stub says.
    triangle = np.asarray(np.linalg.qr(equations, mode="r"))

    mean, covariance, _ = _normal(triangle, _deviations(model))
    # Sums over blocks scatter more than those of single images if neighbours' errors are alike.
    pulls = np.einsum("kmi,km->ki", rows, rows @ mean - wanted)
    blocks = np.unique(np.floor(model.path.stamps_s[good] / _BLOCK_S), return_index=True)[1]
    sums = np.add.reduceat(pulls, np.sort(blocks))
    fitted = float(np.sum((triangle[:, :-1] @ covariance) * triangle[:, :-1]))
    noise = float(np.sum((sums @ covariance) * sums)) / fitted
    count = len(rows) * model.kind.size
    noise = max(1.0, noise * count / max(count - fitted, 1.0))

    parts = [
        _normal(triangle / np.sqrt(noise), _deviations(model, *shares))
        for shares in product(_LINK_SHARES, _OTHER_SHARES)
    ]
    means, covariances, evidence = (np.array(part) for part in zip(*parts, strict=True))
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    mean = weights @ means
    spread = np.sqrt(weights)[:, None] * (means - mean)
    covariance = np.einsum("s,sij->ij", weights, covariances) + spread.T @ spread
    # What no residual tells.
    camera = triangle[:, :6]
    bias = np.linalg.inv(camera.T @ camera / len(rows) + np.eye(6))
    covariance[:6, :6] += _BIAS * (noise - 1.0) * bias
    return mean, covariance, good, float(evidence.max() - evidence[-_OTHER_SHARES.size :].max())


def _normal(equations: np.ndarray, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean, covariance and evidence of unknowns about zero with white linear equations.

    Takes slopes and, as the last column, values. The evidence lacks a constant.
    """
    size = deviation.size
    scaled = np.vstack([equations * np.append(deviation, 1.0), np.eye(size, size + 1)])
    triangle = np.asarray(np.linalg.qr(scaled, mode="r"))
    axes = deviation[:, None] * solve_triangular(triangle[:size, :size], np.eye(size))
    evidence = -0.5 * triangle[-1, -1] ** 2 - np.log(np.abs(np.diag(triangle)[:size])).sum()
    return axes @ triangle[:size, -1], axes @ axes.T, float(evidence)
