"""What a person does on the page: said in the page's threads, done in the node's."""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

CONTROLLER, ESTIMATOR, SIMULATOR = "fvs_controller_node", "fvs_estimator_node", "fvs_sim_node"


@dataclass(frozen=True)
class Action:
    """One press, one choice or one drag.

    Parameters
    ----------
    name : str
        What to do: a service of the controller, ``target``, ``tour``, ``reset``, ``bump``; or a
        node and its parameter with a slash between them, to set that.
    value : bool, float, str or tuple of float, optional
        The target (camera frame, m), whether the tour goes on, or the parameter's value.
    """

    name: str
    value: Any = None

    @property
    def sets_parameter(self) -> bool:
        """Whether it sets a parameter."""
        return "/" in self.name


START, STOP, SET_CURRENT = Action("start"), Action("stop"), Action("set_current_as_target")
RESET, BUMP = Action("reset"), Action("bump")


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
        """All that was said since the last call, in order; of equal names only the last.

        A stop comes first, and a motion that was wanted before it is forgotten. A reset stops, too.
        """
        said: list[Action] = []
        while not self._queue.empty():  # this is its only reader
            said.append(self._queue.get_nowait())
        stops = [i for i, action in enumerate(said) if action in (STOP, RESET)]
        if stops:
            last = stops[-1]
            set_before = [action for action in said[:last] if action.sets_parameter]
            said = [said[last], *set_before, *said[last + 1 :]]
        names = [action.name for action in said]
        return [action for i, action in enumerate(said) if action.name not in names[i + 1 :]]


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
