"""The compared laws (48) and (49): each is the minimiser of its cost."""

import math

import numpy as np
import pytest
from cases import each
from scipy.integrate import quad

from fvs_controller_node.base import ControlInput
from fvs_controller_node.proportional import MfacGains, MfacLaw, MpcGains, MpcLaw, mpc_coefficients

RNG = np.random.default_rng(11)
JACOBIAN = 0.4 * RNG.normal(size=(3, 6))
ERROR_M = np.array([0.2, -0.1, 0.15])


def velocity(law, error_m=ERROR_M, jacobian=JACOBIAN, dt_s=0.008):
    """Joint velocities, rad/s, with the arm at rest."""
    state = ControlInput(np.asarray(error_m, float), jacobian, np.zeros(6), np.zeros(6), dt_s)
    return law.command(state).velocity_rad_s


# --- MFAC, eq. (48) ---


@each("damping", [1e-3, 0.15, 2.0])
def test_the_mfac_increment_minimises_its_cost(damping: float):
    # |e - J dr|^2 + lambda |dr|^2 as one least squares problem; e = x_d - x
    stacked = np.vstack([JACOBIAN, math.sqrt(damping) * np.eye(6)])
    wanted = np.linalg.lstsq(stacked, np.concatenate([-ERROR_M, np.zeros(6)]), rcond=None)[0]
    law = MfacLaw(MfacGains(mfac_lambda=damping, control_interval_s=1.0))
    np.testing.assert_allclose(velocity(law), wanted, rtol=1e-10)


def test_the_mfac_velocity_is_the_increment_over_the_interval_whatever_the_tick():
    once = velocity(MfacLaw(MfacGains(1.0, 0.15)))
    np.testing.assert_allclose(velocity(MfacLaw(MfacGains(0.04, 0.15))), once / 0.04, rtol=1e-13)
    np.testing.assert_array_equal(
        velocity(MfacLaw(MfacGains(0.04, 0.15)), dt_s=0.002),
        velocity(MfacLaw(MfacGains(0.04, 0.15)), dt_s=0.04),
    )


# --- MPC, eq. (49) ---


def printed_coefficients(horizon: float, alpha: float, rho: float) -> tuple[float, float, float]:
    """a, b and c as the paper prints them."""

    def moment(log_weight: float) -> float:
        power = math.exp(horizon * log_weight)
        return (horizon * power * log_weight - power + 1.0) / log_weight**2

    log_alpha = math.log(alpha)
    b, c = moment(log_alpha), moment(log_alpha - rho)
    return (horizon**2 * alpha**horizon - 2.0 * b) / log_alpha, b, c


@each("horizon", [1.0, 10.7, 300.0])
@each("alpha", [0.05, 0.3, 0.64, 0.8])
@each("rho", [0.1, 1.26, 30.0])
def test_the_mpc_coefficients_are_the_printed_ones(horizon: float, alpha: float, rho: float):
    np.testing.assert_allclose(
        mpc_coefficients(horizon, alpha, rho), printed_coefficients(horizon, alpha, rho), rtol=1e-10
    )


def test_the_mpc_coefficients_have_limits_where_the_printed_ones_cancel():
    a, b, _ = mpc_coefficients(10.7, 1.0, 1.26)
    assert a == pytest.approx(10.7**3 / 3.0, rel=1e-13)
    assert b == pytest.approx(10.7**2 / 2.0, rel=1e-13)
    for short_of_one, printed_error in ((1e-6, 0.01), (1e-7, 10.0)):
        near = mpc_coefficients(10.7, 1.0 - short_of_one, 1.26)
        assert near[0] == pytest.approx(a, rel=1e-4)
        printed = printed_coefficients(10.7, 1.0 - short_of_one, 1.26)[0]
        assert abs(printed / near[0] - 1.0) > printed_error


def mpc_cost(u, error, jacobian, weight, *, horizon=10.7, alpha=0.64, rho=1.26) -> float:
    """int_0^H alpha^t |(1 - beta^t) e - t J u|^2 dt + u'Qu, by adaptive quadrature."""

    def running(t: float) -> float:
        left = (1.0 - math.exp(-rho * t)) * error - t * jacobian @ u
        return alpha**t * float(left @ left)

    return quad(running, 0.0, horizon, epsabs=1e-13, epsrel=1e-13)[0] + float(u @ weight @ u)


def central_gradient(function, at: np.ndarray, h: float) -> np.ndarray:
    """Exact for a quadratic, except for rounding."""
    steps = h * np.eye(len(at))
    return np.array([(function(at + step) - function(at - step)) / (2.0 * h) for step in steps])


@each("q", [0.01, 0.07, 1.0])
def test_the_mpc_increment_minimises_its_cost(q: float):
    law = MpcLaw(MpcGains(mpc_q=q, control_interval_s=1.0))
    u = velocity(law)

    def cost(v: np.ndarray) -> float:
        return mpc_cost(v, -ERROR_M, JACOBIAN, q * np.eye(6))

    scale = np.abs(central_gradient(cost, np.zeros(6), 0.1)).max()
    assert np.abs(central_gradient(cost, u, 0.1)).max() < 1e-11 * scale


def test_the_printed_mpc_form_misses_the_minimum_unless_q_is_a_multiple_of_the_identity():
    a, b, c = mpc_coefficients(10.7, 0.64, 1.26)
    error = -ERROR_M
    root = np.random.default_rng(12).normal(size=(6, 6))

    def both(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        right = np.linalg.solve(a * JACOBIAN.T @ JACOBIAN + weight, (b - c) * JACOBIAN.T @ error)
        printed = np.linalg.pinv(a * JACOBIAN + np.linalg.pinv(JACOBIAN.T) @ weight)
        return right, printed @ ((b - c) * error)

    def slope(u: np.ndarray, weight: np.ndarray) -> float:
        """Largest entry of the cost's gradient."""
        return np.abs(
            central_gradient(lambda v: mpc_cost(v, error, JACOBIAN, weight), u, 0.1)
        ).max()

    for weight in (np.diag([0.01, 0.03, 0.1, 0.3, 1.0, 3.0]), 0.1 * root @ root.T):
        right, printed = both(weight)
        at_rest = slope(np.zeros(6), weight)
        assert slope(right, weight) < 1e-11 * at_rest
        assert slope(printed, weight) > 1e-2 * at_rest
        least = mpc_cost(right, error, JACOBIAN, weight)
        assert mpc_cost(printed, error, JACOBIAN, weight) > 1.02 * least
    right, printed = both(0.07 * np.eye(6))
    np.testing.assert_allclose(printed, right, rtol=1e-10)
