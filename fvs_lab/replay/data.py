"""A recording in memory: arrays of what was on the topics, and what the nodes said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fvs_ros.params import Parameter, ParameterError, ParameterSet


@dataclass(frozen=True)
class Series:
    """Numbers of one topic, n messages.

    Parameters
    ----------
    topic : str
        Full name.
    arrival_s : ndarray, shape (n,)
        When each came, s.
    stamp_s : ndarray, shape (n,)
        What its header said, s; not a number where there is none.
    values : ndarray, shape (n, k)
        What it held.
    """

    topic: str
    arrival_s: np.ndarray
    stamp_s: np.ndarray
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.arrival_s)


@dataclass(frozen=True)
class Said:
    """One status, or one line of the log.

    Parameters
    ----------
    arrival_s : float
        When it came, s.
    who : str
        The node.
    text : str
        Its sentence.
    values : mapping of str to str
        Its key numbers.
    """

    arrival_s: float
    who: str
    text: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Flow:
    """All messages of one topic, by time alone.

    Parameters
    ----------
    message_type : str
        Such as ``sensor_msgs/msg/JointState``.
    arrival_s, stamp_s : ndarray, shape (n,)
        As in :class:`Series`.
    """

    message_type: str
    arrival_s: np.ndarray
    stamp_s: np.ndarray


@dataclass(frozen=True)
class Recording:
    """A bag.

    Parameters
    ----------
    path : Path
        Where it lies.
    namespace : str
        Of the nodes, without slashes.
    version : str
        Of this package when it was recorded; empty where the bag does not say.
    scenario : mapping
        Node -> parameter -> value, as started; empty where the bag does not say.
    cut_off : bool
        Whether it was never finished, so that its end may be missing.
    start_s, end_s : float
        First and last arrival, s.
    series : mapping of str to Series
        By the names of ``TOPICS``; what is not in the bag is not in it.
    said : mapping of str to list of Said
        Statuses of ``controller`` and ``estimator``, warnings of the ``log``, and changes of
        ``parameters``.
    flows : mapping of str to Flow
        Every topic, by its full name.
    """

    path: Path
    namespace: str
    version: str
    scenario: Mapping[str, Mapping[str, Any]]
    cut_off: bool
    start_s: float
    end_s: float
    series: Mapping[str, Series]
    said: Mapping[str, Sequence[Said]]
    flows: Mapping[str, Flow]

    def started(self, node: str, parameters: Sequence[Parameter]) -> dict[str, Any]:
        """A node's parameters as started; the defaults where the bag does not say."""
        declared = ParameterSet(parameters)
        given = dict(self.scenario.get(node, {}))
        given.pop("use_sim_time", None)
        try:
            return declared.values(given)
        except ParameterError:  # another version's
            return declared.values()
