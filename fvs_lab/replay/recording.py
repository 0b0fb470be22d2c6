"""A recording as arrays: what was on the topics, and what the nodes said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fvs_controller_node.config import PARAMETERS
from fvs_ros import topics
from fvs_ros.params import Parameter, ParameterError, ParameterSet

CONTROLLER = "fvs_controller_node"
#: The topics that are read, by the name under which their messages are kept here.
TOPICS = {
    "joints": topics.JOINT_STATES.name,
    "ball": topics.BALL_POSITION.name,
    "true_ball": topics.TRUE_BALL_POSITION.name,
    "target": topics.TARGET_POSITION.name,
    "commands": topics.COMMANDS.name,
    "jacobian": topics.JACOBIAN.name,
    "controller": topics.CONTROLLER_STATUS.name,
}


@dataclass(frozen=True)
class Series:
    """Messages of one topic, n in order of arrival.

    Parameters
    ----------
    topic : str
        Full name.
    arrival_s, stamp_s : ndarray, shape (n,)
        Times of arrival, and of the headers, s; not a number where there is none.
    values : ndarray, shape (n, k)
        Numbers of each message; k is 0 where only the times are read.
    """

    topic: str
    arrival_s: np.ndarray
    stamp_s: np.ndarray
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.arrival_s)

    @cached_property
    def time_s(self) -> np.ndarray:
        """Stamps, and arrivals where there is none, s, shape (n,)."""
        return np.where(np.isfinite(self.stamp_s), self.stamp_s, self.arrival_s)

    def taking(self, rows: Any) -> Series:
        """Some of the messages, by anything that indexes an array."""
        values = self.values[rows]
        return replace(
            self, arrival_s=self.arrival_s[rows], stamp_s=self.stamp_s[rows], values=values
        )

    def by_time(self) -> Series:
        """The messages in the order of ``time_s``."""
        in_order = bool((np.diff(self.time_s) >= 0.0).all())
        return self if in_order else self.taking(np.argsort(self.time_s, kind="stable"))


class Status(NamedTuple):
    """One status of the controller: arrival, s, its words, and its target, m, if it has one."""

    arrival_s: float
    state: str
    reason: str
    limit: str
    text: str
    target_m: np.ndarray | None


class Event(NamedTuple):
    """A warning, a changed parameter or a silence: first time, s, node or topic, and how often."""

    time_s: float
    who: str
    text: str
    times: int = 1


@dataclass(frozen=True)
class Recording:
    """What a bag holds.

    Parameters
    ----------
    namespace : str
        Of the nodes, without slashes.
    version : str
        Of this package when it was recorded; empty where the bag has no notes.
    scenario : mapping
        Node -> parameter -> value, as started; empty where the bag has no notes.
    cut_off : bool
        Whether the recorder never finished it.
    start_s, end_s : float
        First and last arrival, s.
    topics : mapping of str to Series
        All messages of each topic, by its full name, without values.
    series : mapping of str to Series
        By the names of ``TOPICS``; only messages that the nodes would accept.
    statuses : sequence of Status
        The controller's.
    events : sequence of Event
        Warnings of the log and changes of parameters.
    """

    namespace: str
    version: str
    scenario: Mapping[str, Mapping[str, Any]]
    cut_off: bool
    start_s: float
    end_s: float
    topics: Mapping[str, Series]
    series: Mapping[str, Series]
    statuses: Sequence[Status]
    events: Sequence[Event]

    def started(
        self, node: str = CONTROLLER, parameters: Sequence[Parameter] = PARAMETERS
    ) -> dict[str, Any]:
        """A node's parameters as started; the defaults where the bag does not say."""
        return as_started(self.scenario, node, parameters)


def as_started(
    scenario: Mapping[str, Mapping[str, Any]], node: str, parameters: Sequence[Parameter]
) -> dict[str, Any]:
    """A node's parameters as a scenario has them; the defaults where it does not say."""
    declared = ParameterSet(parameters)
    given = {key: one for key, one in scenario.get(node, {}).items() if key != "use_sim_time"}
    try:
        return declared.values(given)
    except ParameterError:  # another version's
        return declared.values()
