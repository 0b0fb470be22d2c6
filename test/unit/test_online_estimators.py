"""Kalman filters, recursive least squares, Broyden's update and the oracle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.broyden import BROYDEN_PARAMETERS, BroydenConfig, BroydenEstimator
from fvs_estimator_node.lkf import LKF_PARAMETERS, KalmanConfig, LkfEstimator
from fvs_estimator_node.oracle import OracleEstimator
from fvs_estimator_node.rbf import RbfConfig, RbfEstimator, RbfModel
from fvs_estimator_node.registry import ESTIMATORS, create_estimator, estimator_factory
from fvs_estimator_node.rls import RLS_PARAMETERS, RlsConfig, RlsEstimator
from fvs_estimator_node.ukf import UKF_PARAMETERS, UkfConfig, UkfEstimator

ONLINE = ("lkf", "ukf", "rls", "broyden")
CONFIGS = {
    "lkf": (KalmanConfig, LKF_PARAMETERS),
    "ukf": (UkfConfig, UKF_PARAMETERS),
    "rls": (RlsConfig, RLS_PARAMETERS),
    "broyden": (BroydenConfig, BROYDEN_PARAMETERS),
}
HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
ZERO = {f"{method}.initial": "zero" for method in ONLINE}


def random_model(seed=0, neurons=5):
    rng = np.random.default_rng(seed)
    return RbfModel(
        rng.uniform(-1.0, 1.0, (6, neurons, 6)),
        rng.uniform(1.0, 2.5, (6, neurons)),
        rng.normal(size=(6, 3, neurons)),
    )


def random_steps(rng, count, jacobian=None, noise_m=0.0, joints=6):
    """Steps of a linear plant, or of no plant at all."""
    steps = []
    for _ in range(count):
        d_joints = np.zeros(6)
        d_joints[:joints] = 0.05 * rng.uniform(-1.0, 1.0, joints)
        d_ball = 0.02 * rng.normal(size=3) if jacobian is None else jacobian @ d_joints
        d_ball = d_ball + noise_m * rng.normal(size=3)
        dt_s = rng.uniform(0.02, 0.1)
        steps.append(MotionStep(1.0, dt_s, HOME, d_joints, d_ball))
    return steps


def learn(estimator, steps):
    for step in steps:
        estimator.update(step)
    return estimator.jacobian(HOME)


def entries_covariance(estimator):
    """Covariance of the 18 entries, of a filter with one shared by the rows too."""
    covariance = estimator.covariance
    return covariance if len(covariance) == 18 else np.kron(np.eye(3), covariance)


# --- what each method is ---


@pytest.mark.parametrize("method", ONLINE)
def test_the_jacobian_of_a_linear_plant_is_learnt(method):
    rng = np.random.default_rng(1)
    true = rng.normal(size=(3, 6))
    estimator = create_estimator(method, None, {**ZERO, f"{method}.initial_deviation_m_rad": 0.5})
    learned = learn(estimator, random_steps(rng, 1000, true))
    assert np.linalg.norm(learned - true) < 1e-3 * np.linalg.norm(true)
    assert estimator.updates == 1000


@pytest.mark.parametrize("joints", [6, 2])
def test_the_unscented_filter_is_the_linear_one(joints):
    rng = np.random.default_rng(2)
    linear = LkfEstimator(None, KalmanConfig(initial="zero"))
    unscented = UkfEstimator(None, UkfConfig(initial="zero"))
    for step in random_steps(rng, 1500, joints=joints):
        linear.update(step)
        unscented.update(step)
    assert linear.updates == unscented.updates == 1500
    np.testing.assert_allclose(unscented.jacobian(HOME), linear.jacobian(HOME), atol=1e-9)
    np.testing.assert_allclose(
        entries_covariance(unscented), entries_covariance(linear), rtol=1e-9, atol=1e-11
    )


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"), [(0.1, 2.0, 0.0), (1.0, 0.0, 3.0), (0.5, 2.0, -15.0)]
)
def test_the_spread_of_the_sigma_points_makes_no_difference(alpha, beta, kappa):
    steps = random_steps(np.random.default_rng(3), 300)
    usual = UkfEstimator(None, UkfConfig(initial="zero"))
    other = UkfEstimator(None, UkfConfig("zero", alpha=alpha, beta=beta, kappa=kappa))
    np.testing.assert_allclose(learn(other, steps), learn(usual, steps), atol=1e-9)
    assert other.refused == 0


@pytest.mark.parametrize("estimator_type", [LkfEstimator, UkfEstimator])
def test_both_are_filterpys_linear_filter_of_18_states(estimator_type):
    kalman = pytest.importorskip("filterpy.kalman")
    config = UkfConfig(process_noise=4e-3, measurement_noise_m=2e-3)
    model = random_model()
    judge = kalman.KalmanFilter(dim_x=18, dim_z=3)
    judge.x = model.jacobian(HOME).reshape(18, 1)
    judge.P = config.initial_deviation_m_rad**2 * np.eye(18)
    judge.R = 2.0 * config.measurement_noise_m**2 * np.eye(3)
    estimator = estimator_type(model, config)
    for step in random_steps(np.random.default_rng(4), 500):
        judge.predict(F=np.eye(18), Q=config.process_noise * step.dt_s * np.eye(18))
        judge.update(step.d_ball_m[:, None], H=np.kron(np.eye(3), step.d_joints_rad))
        estimator.update(step)
        np.testing.assert_allclose(estimator.jacobian(HOME).reshape(18, 1), judge.x, atol=1e-9)
        np.testing.assert_allclose(entries_covariance(estimator), judge.P, atol=1e-11)


@pytest.mark.parametrize("estimator_type", [LkfEstimator, UkfEstimator])
def test_both_are_filterpys_unscented_filter_of_18_states(estimator_type):
    kalman = pytest.importorskip("filterpy.kalman")
    config = UkfConfig(process_noise=4e-3, measurement_noise_m=2e-3)
    model = random_model()
    judge = kalman.UnscentedKalmanFilter(
        dim_x=18,
        dim_z=3,
        dt=1.0,
        fx=lambda state, dt: state,
        hx=lambda state, d_joints: state.reshape(3, 6) @ d_joints,
        points=kalman.MerweScaledSigmaPoints(18, config.alpha, config.beta, config.kappa),
    )
    judge.x = model.jacobian(HOME).reshape(18)
    judge.P = config.initial_deviation_m_rad**2 * np.eye(18)
    judge.R = 2.0 * config.measurement_noise_m**2 * np.eye(3)
    estimator = estimator_type(model, config)
    for step in random_steps(np.random.default_rng(5), 300):
        judge.Q = config.process_noise * step.dt_s * np.eye(18)
        judge.predict()
        judge.update(step.d_ball_m, d_joints=step.d_joints_rad)
        estimator.update(step)
        np.testing.assert_allclose(estimator.jacobian(HOME).reshape(18), judge.x, atol=1e-9)
        np.testing.assert_allclose(entries_covariance(estimator), judge.P, atol=1e-11)


@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.9])
def test_recursive_least_squares_are_the_batch_ones(forgetting):
    rng = np.random.default_rng(6)
    config = RlsConfig(
        forgetting=forgetting,
        measurement_noise_m=2e-3,
        initial_deviation_m_rad=0.3,
        wind_up_limit=1e6,
    )
    model = random_model()
    estimator = RlsEstimator(model, config)
    steps = random_steps(rng, 40)
    for count, step in enumerate(steps, start=1):
        estimator.update(step)
        weights = forgetting ** np.arange(count - 1, -1, -1) / (2.0 * config.measurement_noise_m**2)
        start_weight = forgetting**count / config.initial_deviation_m_rad**2
        motions = np.array([s.d_joints_rad for s in steps[:count]])
        balls = np.array([s.d_ball_m for s in steps[:count]])
        normal = motions.T @ (weights[:, None] * motions) + start_weight * np.eye(6)
        right = balls.T @ (weights[:, None] * motions) + start_weight * model.jacobian(HOME)
        batch = np.linalg.solve(normal, right.T).T
        np.testing.assert_allclose(estimator.jacobian(HOME), batch, rtol=1e-9, atol=1e-9)


def test_broyden_with_gain_one_explains_the_last_step_and_changes_the_least():
    rng = np.random.default_rng(7)
    estimator = BroydenEstimator(random_model(), BroydenConfig(gain=1.0))
    for step in random_steps(rng, 20):
        before = estimator.jacobian(HOME)
        estimator.update(step)
        after = estimator.jacobian(HOME)
        np.testing.assert_allclose(after @ step.d_joints_rad, step.d_ball_m, atol=1e-12)
        across = rng.normal(size=6)
        across -= (
            step.d_joints_rad
            * (across @ step.d_joints_rad)
            / step.d_joints_rad.dot(step.d_joints_rad)
        )
        np.testing.assert_allclose(after @ across, before @ across, atol=1e-12)


def test_broyden_corrects_the_share_of_its_gain():
    estimator = BroydenEstimator(random_model(), BroydenConfig(gain=0.25))
    (step,) = random_steps(np.random.default_rng(8), 1)
    before = step.d_ball_m - estimator.jacobian(HOME) @ step.d_joints_rad
    estimator.update(step)
    after = step.d_ball_m - estimator.jacobian(HOME) @ step.d_joints_rad
    np.testing.assert_allclose(after, 0.75 * before, rtol=1e-9)


# --- rest, wind-up and nonsense ---


@pytest.mark.parametrize("method", ONLINE)
def test_a_long_rest_changes_nothing_and_winds_nothing_up(method):
    rng = np.random.default_rng(9)
    true = rng.normal(size=(3, 6))
    rested, busy = (create_estimator(method, random_model(), {}) for _ in range(2))
    steps = random_steps(rng, 200, true, noise_m=0.001)
    learn(rested, steps)
    learn(busy, steps)
    for _ in range(20_000):
        rested.update(MotionStep(1.0, 0.04, HOME, np.full(6, 9e-4), 0.002 * rng.normal(size=3)))
    np.testing.assert_array_equal(rested.jacobian(HOME), busy.jacobian(HOME))
    np.testing.assert_array_equal(rested.covariance, busy.covariance)
    assert rested.updates == busy.updates
    steps = random_steps(rng, 1, true, noise_m=0.001)
    np.testing.assert_array_equal(learn(rested, steps), learn(busy, steps))


def test_least_squares_do_not_wind_up_where_nothing_moves():
    rng = np.random.default_rng(10)
    true = rng.normal(size=(3, 6))
    for limit in (1.0, 3.0):
        estimator = RlsEstimator(random_model(), RlsConfig(forgetting=0.95, wind_up_limit=limit))
        learn(estimator, random_steps(rng, 3000, true, noise_m=0.001, joints=2))
        variances = np.linalg.eigvalsh(estimator.covariance)
        assert math.sqrt(variances[-1]) == pytest.approx(0.1 * limit)
        assert math.sqrt(variances[1]) < 0.02, "what moves is still known well"
    before = estimator.jacobian(HOME)
    after = learn(estimator, random_steps(rng, 1, before, noise_m=0.001))
    assert np.abs(after - before).max() < 0.1


@pytest.mark.parametrize("method", ["lkf", "ukf", "rls"])
def test_the_covariance_stays_symmetric_and_positive_over_long_runs(method):
    rng = np.random.default_rng(11)
    for noise in ({}, {f"{method}.measurement_noise_m": 1e-6}):
        estimator = create_estimator(method, None, {**ZERO, **noise})
        learn(estimator, random_steps(rng, 2000))
        learn(estimator, random_steps(rng, 2000, joints=1))
        assert estimator.refused == 0
        covariance = estimator.covariance
        np.testing.assert_array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance)[0] > 0.0


@pytest.mark.parametrize("method", ONLINE)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
def test_a_step_that_is_not_finite_or_absurd_leaves_a_finite_jacobian(method, bad):
    rng = np.random.default_rng(12)
    estimator = create_estimator(method, random_model(), {})
    learn(estimator, random_steps(rng, 5))
    (good,) = random_steps(rng, 1)
    for name in ("dt_s", "joints_rad", "d_joints_rad", "d_ball_m"):
        value = {**good.__dict__}
        value[name] = bad if name == "dt_s" else np.full(np.shape(value[name]), bad)
        before = estimator.jacobian(HOME), estimator.covariance
        estimator.update(MotionStep(**value))
        if math.isfinite(bad):
            assert np.all(np.isfinite(estimator.jacobian(HOME)))
        else:
            np.testing.assert_array_equal(estimator.jacobian(HOME), before[0])
            np.testing.assert_array_equal(estimator.covariance, before[1])
    assert estimator.refused >= 3


@pytest.mark.parametrize("method", ONLINE)
@pytest.mark.parametrize("dt_s", [0.0, -0.04])
def test_a_step_without_duration_changes_nothing(method, dt_s):
    estimator = create_estimator(method, random_model(), {})
    before = estimator.jacobian(HOME)
    estimator.update(MotionStep(1.0, dt_s, HOME, np.full(6, 0.1), np.ones(3)))
    np.testing.assert_array_equal(estimator.jacobian(HOME), before)
    assert (estimator.updates, estimator.refused) == (0, 1)


_NUMBER = st.floats(allow_nan=False, allow_infinity=False)
_SANE = st.floats(-1.0, 1.0)


def _vectors(size):
    return st.one_of(
        st.lists(_SANE, min_size=size, max_size=size),
        st.lists(_NUMBER, min_size=size, max_size=size),
    )


_STEPS = st.lists(
    st.builds(
        lambda dt_s, joints, d_joints, d_ball: MotionStep(
            1.0, dt_s, np.array(joints), np.array(d_joints), np.array(d_ball)
        ),
        st.one_of(st.floats(0.01, 0.5), _NUMBER),
        _vectors(6),
        _vectors(6),
        _vectors(3),
    ),
    max_size=12,
)


@pytest.mark.parametrize("initial", ["model", "zero"])
@pytest.mark.parametrize("method", ONLINE)
@settings(deadline=None, max_examples=60)
@given(steps=_STEPS)
def test_no_sequence_of_finite_steps_makes_a_jacobian_that_is_not_finite(method, initial, steps):
    values = {f"{method}.initial": initial, f"{method}.min_motion_rad": 0.0}
    estimator = create_estimator(method, random_model(), values)
    for step in steps:
        estimator.update(step)
        assert np.all(np.isfinite(estimator.jacobian(HOME)))
        assert np.all(np.isfinite(estimator.covariance))
        if estimator.covariance.size:
            np.linalg.cholesky(estimator.covariance)
    assert all(math.isfinite(value) for value in estimator.status_values().values())


# --- beginning and ending ---


@pytest.mark.parametrize("method", ONLINE)
def test_it_starts_from_the_model_at_the_first_joints_and_reset_starts_again(method):
    rng = np.random.default_rng(13)
    model = random_model()
    asked, told = (create_estimator(method, model, {}) for _ in range(2))
    first, later = HOME + 0.1, HOME - 0.2
    assert asked.problem == ""
    np.testing.assert_allclose(asked.jacobian(first), model.jacobian(first))
    np.testing.assert_allclose(asked.jacobian(later), model.jacobian(first))
    step = MotionStep(1.0, 0.04, first, np.full(6, 0.05), 0.1 * rng.normal(size=3))
    asked.update(step)
    told.update(step)
    np.testing.assert_array_equal(asked.jacobian(first), told.jacobian(later))
    fresh = create_estimator(method, model, {})
    learn(asked, random_steps(rng, 30))
    asked.reset()
    assert (asked.updates, asked.refused) == (0, 0)
    np.testing.assert_array_equal(asked.covariance, fresh.covariance)
    np.testing.assert_allclose(asked.jacobian(later), model.jacobian(later))


@pytest.mark.parametrize("method", ONLINE)
def test_from_zero_it_needs_no_model(method):
    assert not estimator_factory(method).needs_model(ZERO)
    estimator = create_estimator(method, None, ZERO)
    np.testing.assert_array_equal(estimator.jacobian(HOME), np.zeros((3, 6)))
    learned = learn(estimator, random_steps(np.random.default_rng(14), 20))
    assert np.linalg.norm(learned) > 0.01
    estimator.reset()
    np.testing.assert_array_equal(estimator.jacobian(HOME), np.zeros((3, 6)))


@pytest.mark.parametrize("method", ONLINE)
def test_from_the_model_it_needs_one_and_says_so(method):
    assert estimator_factory(method).needs_model({})
    with pytest.raises(ValueError, match=f"{method} needs a trained model.*{method}.initial to"):
        create_estimator(method)
    kind, config = type(create_estimator(method, None, ZERO)), CONFIGS[method][0]()
    with pytest.raises(ValueError, match="there is no trained model"):
        kind(None, config)


@pytest.mark.parametrize("method", ONLINE)
def test_a_returned_jacobian_is_the_callers_to_keep(method):
    estimator = create_estimator(method, random_model(), {})
    estimator.jacobian(HOME)[:] = np.nan
    estimator.covariance[:] = np.nan
    assert np.all(np.isfinite(learn(estimator, random_steps(np.random.default_rng(15), 3))))


@pytest.mark.parametrize("method", ONLINE)
def test_every_declared_parameter_reaches_the_configuration(method):
    kind, parameters = CONFIGS[method]
    assert {p.name for p in parameters} == {f"{method}.{name}" for name in kind().__dict__}
    defaults = {p.name: p.default for p in parameters}
    assert create_estimator(method, random_model(), defaults).config == kind()
    changed = create_estimator(
        method, random_model(), {f"{method}.min_motion_rad": 0.5, "other.min_motion_rad": 0.7}
    )
    assert changed.config.min_motion_rad == 0.5
    for parameter in parameters:
        for value in (parameter.minimum, parameter.maximum, *parameter.choices):
            if value is not None:
                create_estimator(method, random_model(), {parameter.name: value})


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (KalmanConfig, "initial", "psychic"),
        (BroydenConfig, "min_motion_rad", -1e-3),
        (KalmanConfig, "process_noise", -1.0),
        (KalmanConfig, "measurement_noise_m", 0.0),
        (KalmanConfig, "initial_deviation_m_rad", math.nan),
        (UkfConfig, "alpha", 0.0),
        (UkfConfig, "beta", math.inf),
        (UkfConfig, "kappa", -18.0),
        (RlsConfig, "forgetting", 1.01),
        (RlsConfig, "wind_up_limit", 0.5),
        (RlsConfig, "measurement_noise_m", -1.0),
        (BroydenConfig, "gain", 2.0),
    ],
)
def test_a_wrong_setting_is_refused_with_its_name(kind, name, value):
    with pytest.raises(ValueError, match=f"{name}.*{value}"):
        kind(**{name: value})


def test_the_registry_lists_all_methods():
    assert {"rbf", "frozen", "rbf_left", "poe", *ONLINE, "oracle"} == set(ESTIMATORS)
    with pytest.raises(ValueError, match="unknown estimator method 'kalman'; known are broyden"):
        create_estimator("kalman")


# --- the oracle, and what a status shows ---


def test_the_oracle_hands_on_what_a_simulation_computes():
    oracle = OracleEstimator(lambda joints: np.outer([1.0, 2.0, 3.0], joints))
    assert oracle.problem == ""
    assert not oracle.learns
    before = oracle.jacobian(HOME)
    learn(oracle, random_steps(np.random.default_rng(16), 5))
    oracle.reset()
    np.testing.assert_array_equal(oracle.jacobian(HOME), before)
    np.testing.assert_array_equal(oracle.jacobian(HOME + 1.0)[0], HOME + 1.0)


def test_the_oracle_knows_nothing_until_it_is_told():
    oracle = create_estimator("oracle")
    assert "only a simulator" in oracle.problem
    assert np.all(np.isnan(oracle.jacobian(HOME)))
    told = np.arange(18.0).reshape(3, 6)
    oracle.tell(told)
    assert oracle.problem == ""
    np.testing.assert_array_equal(oracle.jacobian(HOME), told)
    for wrong in (np.zeros((6, 3)), np.full((3, 6), np.nan)):
        with pytest.raises(ValueError, match="shape"):
            oracle.tell(wrong)
    np.testing.assert_array_equal(oracle.jacobian(HOME), told)
    oracle.reset()
    assert oracle.problem != ""


@pytest.mark.parametrize("method", [m for m, f in ESTIMATORS.items() if not f.needs_chain])
def test_status_values_are_finite_numbers(method):
    rng = np.random.default_rng(17)
    estimator = create_estimator(method, random_model(), {})
    for _ in range(2):
        values = estimator.status_values()
        assert all(type(value) is float and math.isfinite(value) for value in values.values())
        learn(estimator, random_steps(rng, 3))
        estimator.update(MotionStep(1.0, math.nan, HOME, np.ones(6), np.ones(3)))
    if estimator.learns:
        values = estimator.status_values()
        assert (values["updates"], values["refused"]) == (6.0, 2.0)
        names = {"rbf": "weight_change_m_rad", "rbf_left": "camera_turned_deg"}
        change = values[names.get(method, "jacobian_change_m_rad")]
        assert change > 0.0


def test_the_shown_deviation_is_that_of_an_entry():
    config = KalmanConfig(initial="zero", initial_deviation_m_rad=0.3)
    for estimator in (LkfEstimator(None, config), UkfEstimator(None, UkfConfig(**vars(config)))):
        assert estimator.status_values()["entry_deviation_m_rad"] == pytest.approx(0.3)
        learn(estimator, random_steps(np.random.default_rng(18), 50))
        variances = np.diag(entries_covariance(estimator))
        shown = estimator.status_values()["entry_deviation_m_rad"]
        assert shown == pytest.approx(math.sqrt(variances.mean()))


def test_the_papers_sign_of_the_sliding_term_can_be_compared_but_not_run():
    step = MotionStep(1.0, 0.04, HOME, np.full(6, 0.05), np.zeros(3), np.array([0.1, 0.0, 0.0]))
    changes = []
    for alpha2 in (0.1, -0.1):
        model = random_model()
        estimator = RbfEstimator(model, RbfConfig(n1=0.0, alpha2=alpha2))
        estimator.update(step)
        changes.append(estimator.weights - model.weights)
    assert np.abs(changes[0]).max() > 0.0
    np.testing.assert_allclose(changes[0], -changes[1], atol=1e-15)
    (declared,) = (p for p in ESTIMATORS["rbf"].parameters if p.name == "rbf.alpha2")
    assert declared.minimum == 0.0
    with pytest.raises(ValueError, match="alpha2 must be finite"):
        RbfConfig(alpha2=math.nan)
