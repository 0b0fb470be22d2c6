"""Parameters declared once: type, default, range, unit, description, and whether they are live.

A parameter is a field of a frozen dataclass, made by :func:`parameter`. The dataclass is what the
code reads; its checks, the node's ROS parameters, their descriptors and refusals, the checks of
scenario files and the reference page follow from the declaration.
"""

from __future__ import annotations

import contextlib
import reprlib
import sys
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import partial
from typing import Any, TypeVar

import numpy as np

from fvs_ros.arguments import did_you_mean, unknown

_DECLARED = "parameter"
_Self = TypeVar("_Self", bound="Parameters")

#: What ROS can hold: 64 bits with a sign, and any finite number.
_LARGEST = {int: 2**63 - 1, float: sys.float_info.max}


class ParameterError(ValueError):
    """A parameter with a wrong name or value; the text says what was expected."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node."""

    #: Ends in the unit where it has one (``_s``, ``_m``, ``_rad_s``).
    name: str
    #: A bool, int, float or str, or a list of one of them: the type of its values. An empty list is
    #: one of floats.
    default: Any
    #: One sentence for a user.
    description: str
    #: Inclusive range of a number, or of each number of a list.
    minimum: float | None = None
    maximum: float | None = None
    #: The only values of a string, if given.
    choices: Collection[str] = ()
    #: Required length of a list.
    size: int | None = None
    #: Whether it may change while the node runs.
    live: bool = False
    #: Whether a single number is taken for a list of one.
    broadcast: bool = False

    @property
    def is_list(self) -> bool:
        """Whether the value is a list."""
        return isinstance(self.default, list)

    @property
    def kind(self) -> Any:
        """Type of the value, or of a list's elements."""
        if self.default == []:
            return float
        return type(self.default[0]) if self.is_list else type(self.default)

    def expected(self) -> str:
        """Words for what a value must be."""
        names = {bool: "true or false", int: "whole number", float: "number", str: "text"}
        text = names[self.kind]
        if self.is_list:
            text = f"a list of {text}s" if self.size is None else f"a list of {self.size} {text}s"
            if self.broadcast:
                text += " (or one for all)"
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
        """The value in the parameter's type; a ``ParameterError`` if it has none of its values.

        For a float an int is accepted, and its text: ``1e-4`` is none in YAML 1.1.
        """
        if not self.is_list:
            return self._check_element(value, value)
        if self.broadcast and isinstance(value, (int, float, str)):
            value = [value]
        is_list = hasattr(value, "__len__") and not isinstance(value, str)
        none = self.kind is str and is_list and not value  # ROS knows no type of an empty one
        if not is_list or none or self.size not in (None, len(value)):
            raise self._refusal(value)
        return [self._check_element(element, value) for element in value]

    def _check_element(self, element: Any, whole: Any) -> Any:
        kind = self.kind
        if isinstance(element, np.generic):
            element = element.item()
        if kind is float and (
            isinstance(element, str) or (type(element) is int and abs(element) <= _LARGEST[int])
        ):
            with contextlib.suppress(ValueError):
                element = float(element)
        fits = type(element) is kind  # true and false are no whole numbers
        if fits and kind in (int, float):
            low, high = self.minimum, self.maximum
            fits = -_LARGEST[kind] <= element <= _LARGEST[kind]  # false for NaN, too
            fits = fits and (low is None or element >= low) and (high is None or element <= high)
        if not fits or (self.choices and element not in self.choices):
            raise self._refusal(whole)
        return element

    def _refusal(self, value: Any) -> ParameterError:
        plain = list(value) if isinstance(value, array) else value
        words = reprlib.repr(plain)  # of another process's value: limited in length
        meant = did_you_mean(value, self.choices) if isinstance(value, str) else ""
        return ParameterError(
            f"parameter {self.name} must be {self.expected()}, got {words}; {meant}".rstrip("; ")
        )


class ParameterSet:
    """The declared parameters of one node, by name; each default passes its own check."""

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self._by_name: dict[str, Parameter] = {}
        for parameter in parameters:
            if parameter.name in self._by_name:
                raise ValueError(f"parameter {parameter.name} is declared twice")
            if parameter.kind not in (bool, int, float, str):
                raise ValueError(f"parameter {parameter.name} has no ROS type")
            parameter.check(parameter.default)
            self._by_name[parameter.name] = parameter

    def __iter__(self):
        return iter(self._by_name.values())

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Parameter:
        if name not in self:
            raise ParameterError(unknown("parameter", str(name), sorted(self._by_name)))
        return self._by_name[name]

    def is_slip(self, name: str) -> bool:
        """Whether a name is almost one of them; those of different nodes are at most 0.79 alike."""
        return name not in self and bool(get_close_matches(name, self._by_name, 1, 0.85))

    def values(self, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """All values: the defaults, with checked overrides in their place."""
        defaults = {parameter.name: parameter.default for parameter in self}
        return {**defaults, **self.checked(overrides or {})}

    def checked(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Given values in their parameters' types; a ``ParameterError`` if one is wrong."""
        return {name: self[name].check(value) for name, value in values.items()}


def parameter(default: Any, description: str, *bounds: Any, **options: Any) -> Any:
    """A field of a :class:`Parameters` dataclass that is a node's parameter.

    Bounds, least and greatest, and options are those of :class:`Parameter`; its name is the
    field's. A tuple is a list in ROS.
    """
    values = list(default) if isinstance(default, tuple) else default
    declared = Parameter("", values, description, *bounds, **options)
    return field(default=default, metadata={_DECLARED: declared})


def another_default(owner: type[Parameters], name: str, default: Any) -> Any:
    """A field that takes over a parameter of a base class with another default."""
    (declared,) = (declared for declared in _own(owner) if declared.name == name)
    return field(default=default, metadata={_DECLARED: replace(declared, default=default)})


#: A parameter that may change while the node runs.
live_parameter = partial(parameter, live=True)


@dataclass(frozen=True)
class Parameters:
    """Parameters with values; a wrong value raises a ``ParameterError`` at construction.

    A field made by :func:`parameter` is one parameter; a field whose ``default_factory`` is
    another such class holds that one's parameters, under the same names.
    """

    def __post_init__(self) -> None:
        for declared in _own(type(self)):
            value = declared.check(getattr(self, declared.name))
            object.__setattr__(self, declared.name, tuple(value) if declared.is_list else value)

    @classmethod
    def declared(cls, prefix: str = "") -> tuple[Parameter, ...]:
        """All its parameters as a node declares them, each name after the prefix."""
        own = (replace(item, name=prefix + item.name) for item in _own(cls))
        nested = (item for part in parts_of(cls).values() for item in part.declared(prefix))
        return (*own, *nested)

    @classmethod
    def from_values(cls: type[_Self], values: Mapping[str, Any], prefix: str = "") -> _Self:
        """Take the values that are its own, by name after the prefix; the others default."""
        own = {member.name: prefix + member.name for member in fields(cls)}
        taken = {name: values[long] for name, long in own.items() if long in values}
        parts = {name: part.from_values(values, prefix) for name, part in parts_of(cls).items()}
        return cls(**{**taken, **parts})


def _own(cls: type) -> Iterator[Parameter]:
    for member in fields(cls):
        if _DECLARED in member.metadata:
            yield replace(member.metadata[_DECLARED], name=member.name)


def parts_of(cls: type) -> dict[str, Any]:
    """The classes of parameters that a class of parameters holds, by the fields' names."""
    made: dict[str, Any] = {member.name: member.default_factory for member in fields(cls)}
    return {
        name: part
        for name, part in made.items()
        if isinstance(part, type) and issubclass(part, Parameters)
    }
