"""Fits a chain to a collection so far, and chooses the course of motion that says most about it.

A course is worth the information that its images will carry: the chain's derivatives along it,
weighed by the noise that the fit found. The best of some random courses gains a few seconds over
going on at random, early on; a search for the very best would gain little more.
"""

from __future__ import annotations

import numpy as np

from fvs_estimator_node.chain_chart import N_COORDINATES, Chart, residuals_and_slopes
from fvs_estimator_node.chain_fit import ChainFit, fit_chain
from fvs_estimator_node.collecting import data_set_of
from fvs_estimator_node.knowledge import Findings, NothingYet, Question
from fvs_estimator_node.motion import Course, RandomMotion
from fvs_estimator_node.pairing import BallSample

#: Joints in the box at which the Jacobian's deviation is looked at.
_PLACES = 100
#: Courses that are compared, beside the present one; how far they are looked ahead, s; and images
#: for a second that stand for all.
_COURSES, _AHEAD_S, _LOOKS_HZ = 16, 8.0, 10.0


class ChainExaminer:
    """Answers questions about one collection; remembers its samples."""

    def __init__(self) -> None:
        self._samples: list[BallSample] = []
        self._rng = np.random.default_rng(0)

    def findings(self, question: Question) -> Findings | NothingYet:
        """Fit a chain to all samples so far; this takes a second."""
        self._samples += question.samples
        motion, time_s = question.motion, question.time_s
        low, high = motion.box_rad
        places = self._rng.uniform(low, high, (_PLACES, len(low)))
        try:
            fit = fit_chain(data_set_of(self._samples))
            deviation = float(np.median(fit.jacobian_deviation(places)))
        except ValueError:  # no chain yet, or numbers too bad for linear algebra
            return NothingYet()
        return Findings(
            jacobian_deviation=deviation,
            misfit=fit.misfit,
            image_offset_s=fit.time_offset_s,
            is_chain=fit.is_chain,
            course=best_course(fit, motion, time_s, len(self._samples) / time_s, self._rng),
        )


def best_course(
    fit: ChainFit,
    motion: RandomMotion,
    time_s: float,
    image_rate_hz: float,
    rng: np.random.Generator,
) -> Course:
    """The most informative of some random courses from where the motion is, and the present one.

    Parameters
    ----------
    fit : ChainFit
        What is known.
    motion : RandomMotion
        The motion.
    time_s : float
        Its time at the change, s.
    image_rate_hz : float
        Images for a second, Hz.
    rng : numpy Generator
        Draws the courses.
    """
    known = np.linalg.inv(fit.covariance)
    ahead_s = time_s + np.arange(0.0, _AHEAD_S, 1.0 / _LOOKS_HZ)
    courses = [motion.course]
    courses += [motion.continued(motion.draw(rng), time_s) for _ in range(_COURSES)]

    def worth(course: Course) -> float:
        gained = information(fit, *motion.path(ahead_s, course))
        return float(np.linalg.slogdet(known + image_rate_hz / _LOOKS_HZ * gained)[1])

    return max(courses, key=worth)


def information(fit: ChainFit, joints_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
    """What images would say about a chain: the inverse of the covariance they alone would give.

    Parameters
    ----------
    fit : ChainFit
        The chain, and the noise of an image.
    joints_rad, velocity_rad_s : ndarray, shape (n, 6)
        Joints when the images are taken, rad, and their velocities, rad/s.

    Returns
    -------
    ndarray, shape (28, 28)
        For the coordinates of ``Chart(fit.chain)``; 1/rad^2, 1/m^2 and 1/s^2.
    """
    ball = fit.chain.position(joints_rad)
    zero = np.zeros(N_COORDINATES)
    _, slopes = residuals_and_slopes(Chart(fit.chain), zero, joints_rad, velocity_rad_s, ball)
    sight = ball / np.linalg.norm(ball, axis=1, keepdims=True)
    along = np.einsum("ni,nij->nj", sight, slopes)
    every = slopes.reshape(-1, N_COORDINATES)
    # Of every direction as of those across the line of sight, then the difference along it.
    more = fit.ray_noise_m**-2 - fit.lateral_noise_m**-2
    return fit.lateral_noise_m**-2 * (every.T @ every) + more * (along.T @ along)
