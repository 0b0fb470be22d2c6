"""The estimators by name. A new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.broyden import BROYDEN_PARAMETERS, BroydenConfig, BroydenEstimator
from fvs_estimator_node.left_factor import (
    LEFT_FACTOR_PARAMETERS,
    LeftFactorEstimator,
    left_factor_config,
)
from fvs_estimator_node.lkf import LKF_PARAMETERS, KalmanConfig, LkfEstimator
from fvs_estimator_node.online import FROM_MODEL, OnlineConfig, read_config
from fvs_estimator_node.oracle import OracleEstimator
from fvs_estimator_node.poe import POE_PARAMETERS, PoeEstimator, poe_config
from fvs_estimator_node.rbf import (
    RBF_PARAMETERS,
    FrozenRbfEstimator,
    RbfEstimator,
    RbfModel,
    rbf_config,
)
from fvs_estimator_node.rls import RLS_PARAMETERS, RlsConfig, RlsEstimator
from fvs_estimator_node.ukf import UKF_PARAMETERS, UkfConfig, UkfEstimator
from fvs_ros.chain import SerialChain
from fvs_ros.params import Parameter


@dataclass(frozen=True)
class EstimatorFactory:
    """How an estimator is made.

    Parameters
    ----------
    create : callable
        Takes the trained networks (the fitted chain, if it needs that; None if it needs neither)
        and the parameter values.
    parameters : tuple of Parameter
        What it can be told, to be declared by the node; names begin with the method's.
    needs_model : callable
        Takes the parameter values; whether it cannot do without a trained model.
    needs_chain : bool
        Whether what it takes is the fitted chain.
    """

    create: Callable[[Any, Mapping[str, Any]], Estimator]
    parameters: tuple[Parameter, ...] = ()
    needs_model: Callable[[Mapping[str, Any]], bool] = lambda values: False
    needs_chain: bool = False


def _networks(
    create: Callable[[Any, Mapping[str, Any]], Estimator], parameters: tuple[Parameter, ...] = ()
) -> EstimatorFactory:
    return EstimatorFactory(create, parameters, lambda values: True)


def _online(
    method: str,
    estimator: Callable[[Any, Any], Estimator],
    config: type[OnlineConfig],
    parameters: tuple[Parameter, ...],
) -> EstimatorFactory:
    return EstimatorFactory(
        lambda model, values: estimator(model, read_config(config, method, values)),
        parameters,
        lambda values: read_config(config, method, values).initial == FROM_MODEL,
    )


ESTIMATORS: dict[str, EstimatorFactory] = {
    "rbf": _networks(lambda model, values: RbfEstimator(model, rbf_config(values)), RBF_PARAMETERS),
    "frozen": _networks(lambda model, values: FrozenRbfEstimator(model)),
    "rbf_left": _networks(
        lambda model, values: LeftFactorEstimator(model, left_factor_config(values)),
        LEFT_FACTOR_PARAMETERS,
    ),
    "poe": EstimatorFactory(
        lambda chain, values: PoeEstimator(chain, poe_config(values)),
        POE_PARAMETERS,
        lambda values: True,
        needs_chain=True,
    ),
    "lkf": _online("lkf", LkfEstimator, KalmanConfig, LKF_PARAMETERS),
    "ukf": _online("ukf", UkfEstimator, UkfConfig, UKF_PARAMETERS),
    "rls": _online("rls", RlsEstimator, RlsConfig, RLS_PARAMETERS),
    "broyden": _online("broyden", BroydenEstimator, BroydenConfig, BROYDEN_PARAMETERS),
    "oracle": EstimatorFactory(lambda model, values: OracleEstimator()),
}


def estimator_factory(method: str) -> EstimatorFactory:
    """The factory of a method.

    Raises
    ------
    ValueError
        If the method is unknown; the text lists the known ones.
    """
    try:
        return ESTIMATORS[method]
    except KeyError:
        raise ValueError(
            f"unknown estimator method {method!r}; known are {', '.join(sorted(ESTIMATORS))}"
        ) from None


def create_estimator(
    method: str,
    model: RbfModel | None = None,
    values: Mapping[str, Any] | None = None,
    chain: SerialChain | None = None,
) -> Estimator:
    """Make an estimator.

    Parameters
    ----------
    method : str
        One of ``ESTIMATORS``.
    model : RbfModel, optional
        The trained networks, for methods that need them.
    values : mapping, optional
        Parameter values by name; those of other methods are passed over.
    chain : SerialChain, optional
        The fitted chain, for methods that need it.

    Raises
    ------
    ValueError
        If the method is unknown, lacks its model, or a value is out of range.
    """
    factory = estimator_factory(method)
    values = values or {}
    if factory.needs_chain:
        if chain is None:
            raise ValueError(
                f"estimator method {method} needs a fitted chain: set model_path to a file that "
                "fvs_train --method poe has written"
            )
        return factory.create(chain, values)
    if model is None and factory.needs_model(values):
        start = f"{method}.initial"
        without = f", or {start} to zero" if start in {p.name for p in factory.parameters} else ""
        raise ValueError(
            f"estimator method {method} needs a trained model: set model_path to a file that "
            f"fvs_train has written{without}"
        )
    return factory.create(model, values)


def estimator_parameters() -> tuple[Parameter, ...]:
    """The parameters of all methods, in the order of the registry."""
    return tuple(p for factory in ESTIMATORS.values() for p in factory.parameters)
