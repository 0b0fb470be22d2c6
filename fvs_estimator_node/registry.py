"""The estimators by name. A new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.rbf import (
    RBF_PARAMETERS,
    FrozenRbfEstimator,
    RbfEstimator,
    RbfModel,
    rbf_config,
)
from fvs_ros.core.params import Parameter


@dataclass(frozen=True)
class EstimatorFactory:
    """How an estimator is made.

    Parameters
    ----------
    create : callable
        Takes the trained model (None for methods that need none) and the parameter values.
    parameters : tuple of Parameter
        What it can be told, to be declared by the node; names begin with the method's.
    needs_model : bool
        Whether it cannot do without a trained model.
    """

    create: Callable[[Any, Mapping[str, Any]], Estimator]
    parameters: tuple[Parameter, ...] = ()
    needs_model: bool = False


ESTIMATORS: dict[str, EstimatorFactory] = {
    "rbf": EstimatorFactory(
        lambda model, values: RbfEstimator(model, rbf_config(values)), RBF_PARAMETERS, True
    ),
    "frozen": EstimatorFactory(lambda model, values: FrozenRbfEstimator(model), (), True),
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
    method: str, model: RbfModel | None = None, values: Mapping[str, Any] | None = None
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

    Raises
    ------
    ValueError
        If the method is unknown, lacks its model, or a value is out of range.
    """
    factory = estimator_factory(method)
    if factory.needs_model and model is None:
        raise ValueError(
            f"estimator method {method} needs a trained model: set model_path to a file that "
            "fvs_train has written"
        )
    return factory.create(model, values or {})


def estimator_parameters() -> tuple[Parameter, ...]:
    """The parameters of all methods, in the order of the registry."""
    return tuple(p for factory in ESTIMATORS.values() for p in factory.parameters)
