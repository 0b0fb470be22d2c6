"""Who is compared: every estimator with its starts, and what each is tuned over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fvs_estimator_node.rbf import RbfConfig

#: A faster update than the default, and a filter that hardly believes in noise, for comparison.
FAST_N1 = 3.0
FAST_PROCESS_NOISE = 10.0
#: Standard deviation of an entry of a Jacobian that begins at zero, m/rad.
IGNORANCE_M_RAD = 0.5


@dataclass(frozen=True)
class Grid:
    """A parameter of a method, without the method's name, and the values it is tuned over."""

    parameter: str
    values: tuple[float, ...]


_FILTER_GRID = Grid("process_noise", (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1))
#: Eight values for every method's one free number.
GRIDS = {
    "rbf": Grid("n1", (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)),
    "lkf": _FILTER_GRID,
    "ukf": _FILTER_GRID,
    "rls": Grid("forgetting", (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)),
    "broyden": Grid("gain", (0.03, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)),
}


@dataclass(frozen=True)
class Contestant:
    """An estimator with a start.

    Parameters
    ----------
    name, label : str
        In the data, and for readers.
    method : str
        By the estimators' registry's name.
    values : mapping
        Parameters of the node that are not tuned.
    tuned_as : str
        Whose tuned value is taken, its own or another's name; empty for none's.
    hears_prelude : bool
        Whether it learns from the wiggling before the scored motion.
    """

    name: str
    label: str
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    tuned_as: str = ""
    hears_prelude: bool = True

    @property
    def parameter(self) -> str:
        """The node's parameter that may be tuned."""
        return f"{self.method}.{GRIDS[self.method].parameter}"

    def with_value(self, value: float) -> Contestant:
        """The same with another value of that parameter."""
        return replace(self, values={**self.values, self.parameter: value})

    def tuned(self, chosen: Mapping[str, float]) -> Contestant:
        """The same with its tuned value, if it takes one of these, which are by contestant."""
        return self.with_value(chosen[self.tuned_as]) if self.tuned_as in chosen else self


_METHODS = {"lkf": "LKF", "ukf": "UKF", "rls": "RLS", "broyden": "Broyden"}
_STARTS = {"explored": "explored", "model": "networks' start", "zero": "from zero"}


def _started(method: str, start: str, tuned_as: str = "") -> Contestant:
    """A method with one of three starts; tuned by itself unless another's value is named."""
    name = f"{method}_{start}"
    values: dict[str, Any] = {}
    if start != "model":
        values[f"{method}.initial"] = "zero"
        if method != "broyden":  # which has no notion of how wrong it may be
            values[f"{method}.initial_deviation_m_rad"] = IGNORANCE_M_RAD
    return Contestant(
        name,
        f"{_METHODS[method]}, {_STARTS[start]}",
        method,
        values,
        tuned_as or name,
        hears_prelude=start == "explored",
    )


_LKF_EXPLORED = _started("lkf", "explored")
#: All of them, by name; a UKF takes the LKF's tuned value, for they are one filter.
CONTESTANTS = {
    one.name: one
    for one in (
        Contestant("rbf", f"proposed, n1 = {RbfConfig.n1:g}", "rbf"),
        Contestant("rbf_fast", f"proposed, n1 = {FAST_N1:g}", "rbf", {"rbf.n1": FAST_N1}),
        Contestant("rbf_tuned", "proposed, n1 tuned", "rbf", tuned_as="rbf_tuned"),
        Contestant("frozen", "networks, frozen", "frozen"),
        _LKF_EXPLORED,
        _started("ukf", "explored", tuned_as="lkf_explored"),
        _started("lkf", "model"),
        _started("ukf", "model", tuned_as="lkf_model"),
        _started("lkf", "zero", tuned_as="lkf_explored"),
        replace(
            _LKF_EXPLORED.with_value(FAST_PROCESS_NOISE),
            name="lkf_fast",
            label=f"LKF, explored, process noise {FAST_PROCESS_NOISE:g}",
            tuned_as="",
        ),
        _started("rls", "explored"),
        _started("rls", "model"),
        _started("broyden", "explored"),
        _started("broyden", "model"),
        Contestant("oracle", "true Jacobian (oracle)", "oracle"),
    )
}
#: Those that have a search of their own.
SEARCHED = tuple(one for one in CONTESTANTS.values() if one.tuned_as == one.name)
