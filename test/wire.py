"""A bad network between two nodes: a relay that loses, delays, repeats and spoils messages."""

from __future__ import annotations

import heapq
import itertools
import random
import time
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from fvs_ros import ros

#: What goes through a relay is published on this prefix and the topic.
PREFIX = "wire/"

_DELAY_TIMER_S = 0.004


class Wire:
    """Relays one topic, and does to each message what its attributes say.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose executor turns the relay.
    message_type : type
        Type of the messages.
    topic : str
        Heard here, said again on ``wire/`` + ``topic``.
    seed : int
        Seed of what is lost, repeated and reordered: one sequence of messages, one outcome.

    Attributes
    ----------
    silent : bool
        Nothing comes through.
    loss, repeat, swap : float
        Probability that a message is lost, is said twice, is said after its follower.
    delay_s : float
        Further time under way, s; see ``delay``.
    shift_s : float
        Added to the stamps, s: the sender's clock jumped.
    freeze : str
        Empty; ``stamp``: new contents with the last stamp; ``message``: the last message again.
    spoil : callable or None
        Changes a message, in place or by returning another.
    heard : int
        Messages since it was calm.
    said_s : list of float
        When something was said at the far end, s, ``time.monotonic()``.
    """

    def __init__(self, node: Any, message_type: type, topic: str, seed: int = 0) -> None:
        self._node = node
        self._seed = f"{seed} {topic}"
        self._publisher = node.create_publisher(message_type, PREFIX + topic, ros.QOS_RELIABLE)
        # Deeper than the nodes' own: what the wire loses, it is to lose on purpose.
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(message_type, topic, self._on_message, qos)
        #: Called with every message heard, before anything is done to it.
        self.listeners: list[Callable[[Any], None]] = []
        self._order = itertools.count()
        self._under_way: list[tuple[float, int, Any]] = []
        self._timer: Any = None
        self.calm()

    def calm(self) -> None:
        """Be a good wire again; what is under way is lost, and the luck begins anew."""
        self.silent = False
        self.loss = self.repeat = self.swap = 0.0
        self.shift_s = 0.0
        self.freeze = ""
        self.spoil: Callable[[Any], Any] | None = None
        self._random = random.Random(self._seed)
        self._last: Any = None
        self._held_back: Any = None
        self.heard = 0
        self.said_s: list[float] = []
        self.delay(0.0)

    def delay(self, seconds: float) -> None:
        """Keep each message for so long, s."""
        self.delay_s = seconds
        self._under_way.clear()
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        if seconds > 0.0:
            self._timer = self._node.create_timer(_DELAY_TIMER_S, self._deliver)

    def send(self, message: Any) -> None:
        """Say something of one's own at the far end."""
        self.said_s.append(time.monotonic())
        self._publisher.publish(message)

    def _on_message(self, message: Any) -> None:
        self.heard += 1
        for listener in self.listeners:
            listener(message)
        # Always three numbers a message, so that one setting does not change another's luck.
        lost, repeated, swapped = (self._random.random() for _ in range(3))
        if self.silent or lost < self.loss:
            return
        message = self._disturbed(message)
        if swapped < self.swap and self._held_back is None:
            self._held_back = message
            return
        late, self._held_back = self._held_back, None
        for one in (message, message if repeated < self.repeat else None, late):
            if one is not None:
                self._pass_on(one)

    def _disturbed(self, message: Any) -> Any:
        if self.freeze and self._last is not None:
            if self.freeze == "message":
                return self._last
            message.header.stamp = self._last.header.stamp
            return message
        if self.shift_s:
            stamp_s = ros.from_stamp(message.header.stamp) + self.shift_s
            message.header.stamp = ros.to_stamp(stamp_s)
        if self.spoil is not None:
            message = self.spoil(message) or message
        self._last = message
        return message

    def _pass_on(self, message: Any) -> None:
        if self.delay_s > 0.0:
            due_s = time.monotonic() + self.delay_s
            heapq.heappush(self._under_way, (due_s, next(self._order), message))
        else:
            self.send(message)

    def _deliver(self) -> None:
        while self._under_way and self._under_way[0][0] <= time.monotonic():
            self.send(heapq.heappop(self._under_way)[2])
