"""Parameters declared once: type, default, range, unit, description, and whether they are live.

A node's parameters are one tuple of :class:`Parameter`. Everything else follows from it: the
ROS declaration, the checks, the refusals and the checks of scenario files.
"""

from __future__ import annotations

import reprlib
import sys
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_ros.core.arguments import did_you_mean, unknown

_TYPES = (bool, int, float, str)

#: What ROS can hold: 64 bits with a sign, and any finite number.
_LARGEST = {int: 2**63 - 1, float: sys.float_info.max}


class ParameterError(ValueError):
    """A parameter with a wrong name or value; the text says what was expected."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node.

    Parameters
    ----------
    name : str
        Name; ends in the unit where it has one (``_s``, ``_m``, ``_rad_s``).
    default : bool, int, float, str, or a list of one of them
        Default value; its type is the parameter's type.
    description : str
        One sentence for a user.
    minimum, maximum : float, optional
        Inclusive range of a number, or of each number of a list.
    choices : tuple of str
        The only values allowed for a string, if given.
    size : int, optional
        Required length of a list.
    live : bool
        Whether it may change while the node runs.
    broadcast : bool
        Whether a single number may stand for a list of ``size`` equal ones.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    size: int | None = None
    live: bool = False
    broadcast: bool = False

    @property
    def is_list(self) -> bool:
        """Whether the value is a list."""
        return isinstance(self.default, list)

    @property
    def kind(self) -> Any:
        """Type of the value, or of a list's elements."""
        return type(self.default[0]) if self.is_list else type(self.default)

    def expected(self) -> str:
        """Words for what a value must be."""
        names = {bool: "true or false", int: "whole number", float: "number", str: "text"}
        text = names[self.kind]
        if self.is_list:
            text = f"a list of {text}s" if self.size is None else f"a list of {self.size} {text}s"
            if self.broadcast:
                text += ", or one for all,"
        if self.choices:
            text = "one of " + ", ".join(self.choices)
        if self.minimum is not None and self.maximum is not None:
            text += f" from {self.minimum:g} to {self.maximum:g}"
        elif self.minimum is not None:
            text += f", at least {self.minimum:g}"
        elif self.maximum is not None:
            text += f", at most {self.maximum:g}"
        return text

    def check(self, value: Any) -> Any:
        """The value in the parameter's type.

        A whole number is welcome where a number is wanted (``gain: 2`` in YAML).

        Raises
        ------
        ParameterError
            If the value has another type, size or range.
        """
        if self.is_list:
            if self.broadcast and self.size and isinstance(value, (int, float)):
                value = [value] * self.size
            if isinstance(value, str) or not hasattr(value, "__len__"):
                raise self._refusal(value)
            if self.size is not None and len(value) != self.size:
                raise self._refusal(value)
            return [self._check_one(element, value) for element in value]
        return self._check_one(value, value)

    def _check_one(self, element: Any, whole: Any) -> Any:
        kind = self.kind
        if isinstance(element, np.generic):
            element = element.item()
        if kind is float and isinstance(element, int) and not isinstance(element, bool):
            if abs(element) > _LARGEST[int]:
                raise self._refusal(whole)
            element = float(element)
        if not isinstance(element, kind) or (kind is int and isinstance(element, bool)):
            raise self._refusal(whole)
        if kind in (int, float):
            if not -_LARGEST[kind] <= element <= _LARGEST[kind]:  # false for NaN, too
                raise self._refusal(whole)
            if self.minimum is not None and element < self.minimum:
                raise self._refusal(whole)
            if self.maximum is not None and element > self.maximum:
                raise self._refusal(whole)
        if self.choices and element not in self.choices:
            raise self._refusal(whole)
        return element

    def _refusal(self, value: Any) -> ParameterError:
        given = list(value) if isinstance(value, array) else value
        words = reprlib.repr(given)  # of a stranger's value, so of limited length
        meant = did_you_mean(value, self.choices) if isinstance(value, str) else ""
        return ParameterError(
            f"parameter {self.name} must be {self.expected()}, got {words}; {meant}".rstrip("; ")
        )


class ParameterSet:
    """The declared parameters of one node, by name.

    Parameters
    ----------
    parameters : iterable of Parameter
        The declarations.

    Raises
    ------
    ValueError
        If a name is declared twice or a default does not pass its own check.
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self._by_name: dict[str, Parameter] = {}
        for parameter in parameters:
            if parameter.name in self._by_name:
                raise ValueError(f"parameter {parameter.name} is declared twice")
            if parameter.kind not in _TYPES:
                raise ValueError(f"parameter {parameter.name} has no ROS type")
            parameter.check(parameter.default)
            self._by_name[parameter.name] = parameter

    def __iter__(self):
        return iter(self._by_name.values())

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Parameter:
        try:
            return self._by_name[name]
        except KeyError:
            raise ParameterError(
                f"unknown parameter {name}; known are {', '.join(sorted(self._by_name))}"
            ) from None

    def values(self, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """All values: the defaults, with checked overrides in their place.

        Raises
        ------
        ParameterError
            If an override is unknown or has a wrong value.
        """
        defaults = {parameter.name: parameter.default for parameter in self}
        return {**defaults, **self.checked(overrides or {})}

    def checked(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Given values in their parameters' types.

        Raises
        ------
        ParameterError
            If one is unknown or has a wrong value.
        """
        for name in given:
            if name not in self:
                raise ParameterError(unknown("parameter", str(name), sorted(self._by_name)))
        return {name: self[name].check(value) for name, value in given.items()}
