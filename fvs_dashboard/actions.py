"""What a person does on the page: said in the page's threads, done in the node's."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any, NamedTuple

CONTROLLER, ESTIMATOR, SIMULATOR = "fvs_controller_node", "fvs_estimator_node", "fvs_sim_node"


class Action(NamedTuple):
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
    wake : callable
        Called, in the page's thread, when something has been said.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
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
        said: dict[str, Action] = {}
        while not self._queue.empty():  # this is its only reader
            action = self._queue.get_nowait()
            if action in (STOP, RESET):
                settings = {name: one for name, one in said.items() if one.sets_parameter}
                said = {action.name: action, **settings}
            else:
                said.pop(action.name, None)
                said[action.name] = action
        return list(said.values())
