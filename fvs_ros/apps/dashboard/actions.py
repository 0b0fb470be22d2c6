"""What a person does on the page: said in the page's threads, done in the node's."""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, nan

import numpy as np


@dataclass(frozen=True)
class Call:
    """A button that calls a service of the controller: start, stop, set_current_as_target."""

    service: str


@dataclass(frozen=True)
class Target:
    """A wanted ball position, camera frame, m, (3,)."""

    position_m: tuple[float, float, float]


@dataclass(frozen=True)
class Tour:
    """The tour is switched on or off."""

    on: bool


@dataclass(frozen=True)
class Disturb:
    """A parameter of the simulator and its wanted value."""

    name: str
    value: float | tuple[float, ...]


@dataclass(frozen=True)
class PutBack:
    """The simulated arm is put back where it began."""


@dataclass(frozen=True)
class Remark:
    """Words for the person, of what was not understood."""

    text: str


Action = Call | Target | Tour | Disturb | PutBack | Remark

START, STOP = Call("start"), Call("stop")
SET_CURRENT = Call("set_current_as_target")


class Actions:
    """The queue between the page's threads and the node's.

    Parameters
    ----------
    wake : callable, optional
        Called, in the page's thread, when something has been said.
    """

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        self._queue: queue.SimpleQueue[Action] = queue.SimpleQueue()
        self._wake = wake

    def put(self, action: Action) -> None:
        """Say an action, from any thread."""
        self._queue.put(action)
        self._wake()

    def drain(self) -> list[Action]:
        """All that was said since the last call, in order, of slid values only the last.

        A stop is done before all else, and a motion that was wanted before it is forgotten.
        """
        said: list[Action] = []
        while True:
            try:
                said.append(self._queue.get_nowait())
            except queue.Empty:
                break
        if STOP in said:
            last = len(said) - 1 - said[::-1].index(STOP)
            kept = [action for action in said[:last] if isinstance(action, Disturb)]
            said = [STOP, *kept, *said[last + 1 :]]
        return [a for i, a in enumerate(said) if not any(_replaces(b, a) for b in said[i + 1 :])]


def _replaces(later: Action, earlier: Action) -> bool:
    """Whether a later action makes an earlier one pointless."""
    if isinstance(later, Target):
        return isinstance(earlier, Target)
    if isinstance(later, Disturb):
        return isinstance(earlier, Disturb) and later.name == earlier.name
    return False


def point_of(text: str) -> tuple[float, float, float]:
    """A position that a person has typed.

    Raises
    ------
    ValueError
        If it is not three finite numbers.
    """
    words = text.replace(",", " ").replace(";", " ").split()
    try:
        x, y, z = (float(word) for word in words)
    except ValueError:
        x = y = z = nan
    if not all(isfinite(one) for one in (x, y, z)):
        raise ValueError(f"a target is three numbers in metres, like 0.1, 0.2, 1.5; got '{text}'")
    return x, y, z


def as_point(position_m: np.ndarray) -> tuple[float, float, float]:
    """A position as three plain numbers."""
    x, y, z = (float(value) for value in position_m)
    return x, y, z
