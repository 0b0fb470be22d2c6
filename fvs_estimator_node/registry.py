"""The estimators by name, and the parameters of their node. A new one is one file and one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fvs_estimator_node.base import CHAIN, Estimator, Estimators
from fvs_estimator_node.camera import PoeEstimator, TurnedRbfEstimator
from fvs_estimator_node.files import TrainedModel, load_model
from fvs_estimator_node.on_arm import OnArmPoeEstimator
from fvs_estimator_node.online import LkfEstimator, RlsEstimator, UkfEstimator
from fvs_estimator_node.pixels import PixelPoeEstimator
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfEstimator
from fvs_ros.arguments import unknown
from fvs_ros.joints import JOINT_PARAMETERS
from fvs_ros.kinds import Kind, KindConfig
from fvs_ros.params import Parameter, live_parameter, parameter
from fvs_ros.paths import find_file, registered
from fvs_ros.pixel_chain import PixelChains

#: Likewise an entry point ``fvs_ros.estimators`` of another package.
ESTIMATORS: dict[str, type[Any]] = registered(
    "estimators",
    {
        "rbf": RbfEstimator,
        "frozen": FrozenRbfEstimator,
        "rbf_left": TurnedRbfEstimator,
        "poe": PoeEstimator,
        "lkf": LkfEstimator,
        "ukf": UkfEstimator,
        "rls": RlsEstimator,
    },
)
#: In place of those, with the camera on the arm, and for what is no rigid body.
_ON_ARM: dict[str, type[Any]] = {"poe": OnArmPoeEstimator}
_NOT_RIGID: dict[str, type[Any]] = {"poe": PixelPoeEstimator}


@dataclass(frozen=True)
class EstimatorConfig(KindConfig):
    """Parameters of the node; those of the methods are the estimators'."""

    method: str = live_parameter(
        "rbf",
        "how the Jacobian is estimated; changes only while the controller does not servo",
        choices=ESTIMATORS.keys(),
    )
    model_path: str = parameter(
        "",
        "file that fvs_train has written: a path, or a name within the project's config folder; "
        "empty: that of the simulated UR5",
    )


def trained_model(config: EstimatorConfig, joint_names: Sequence[str]) -> TrainedModel:
    """The model that the parameters name; a ``ValueError`` says why it cannot serve."""
    name = config.model_path or config.kind.model
    if not name:
        raise ValueError(f"model_path: no model comes with a {config.kind.what}; train one")
    try:
        return load_model(find_file(name), joint_names, config)
    except FileNotFoundError as error:
        raise ValueError(f"model_path: {error}; train one with fvs_train") from error


def create_estimator(
    method: str,
    values: Mapping[str, Any] | None = None,
    load: Callable[[], TrainedModel] | None = None,
    kind: Kind | None = None,
) -> Estimator:
    """Make an estimator.

    Parameters
    ----------
    method : str
        One of ``ESTIMATORS``.
    values : mapping, optional
        Parameter values by name; those of other methods are ignored.
    load : callable, optional
        Loads the trained model; called only for a method that needs one.
    kind : Kind, optional
        The kind of feature; a ball by default.

    Raises
    ------
    ValueError
        If the method is unknown, lacks its model, or a value is out of range.
    """
    if method not in ESTIMATORS:
        raise ValueError(unknown("estimator method", method, sorted(ESTIMATORS)))
    made_by = ESTIMATORS[method]
    if kind is not None:
        instead = _ON_ARM if kind.on_arm else {} if kind.rigid else _NOT_RIGID
        made_by = instead.get(method, made_by)
    config = made_by.config_type.from_values(values or {}, f"{made_by.group}.")
    part, source = made_by.needs(config), None
    if part:
        source = getattr(load(), part) if load is not None else None
        if source is None:
            by = "fvs_train --method poe" if part == CHAIN else "fvs_train"
            raise ValueError(
                f"estimator method {method} needs a trained {part}: set model_path to a file that "
                f"{by} has written"
            )
    if kind is None or len(kind.parts) == 1:
        estimator: Estimator = made_by(source, config, kind)
        return estimator
    return Estimators(
        tuple(
            made_by(_of_camera(source, i, rows), config, part)
            for i, (part, rows) in enumerate(zip(kind.parts, kind.rows, strict=True))
        ),
        kind,
    )


def _of_camera(source: Any, camera: int, rows: slice) -> Any:
    """The part of networks or chains that is one camera's."""
    if isinstance(source, PixelChains):
        return source.each[camera]
    return source and replace(source, weights=source.weights[:, rows])


#: Parameters of the methods, each group once, in the order of the registry.
_GROUPS = {made_by.group: made_by.config_type for made_by in ESTIMATORS.values()}
PARAMETERS: tuple[Parameter, ...] = (
    *EstimatorConfig.declared(),
    *JOINT_PARAMETERS,
    *(item for group, config in _GROUPS.items() for item in config.declared(f"{group}.")),
)
