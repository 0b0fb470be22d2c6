"""Nodes of one process: a message between them passes DDS only if another process listens, too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile


class Input(NamedTuple):
    """A subscription that a node asks for."""

    message_type: type
    topic: str
    qos: QoSProfile
    callback: Callable[[Any], None]


class HandingPublisher(Publisher):
    """Hands messages to the hearers in this process, and to DDS if somebody else listens."""

    hearers: tuple[Callable[[Any], None], ...] = ()

    @property
    def volatile(self) -> bool:
        """Whether nobody who comes later gets what was sent."""
        return self.qos_profile.durability == DurabilityPolicy.VOLATILE

    @property
    def heard(self) -> bool:
        """Whether anybody listens."""
        return bool(self.hearers) or self.get_subscription_count() > 0

    def publish(self, msg: Any) -> None:
        """Send a message."""
        for hear in self.hearers:
            hear(msg)
        if not self.hearers or self.get_subscription_count():
            super().publish(msg)


def each(callbacks: tuple[Callable[[Any], None], ...]) -> Callable[[Any], None]:
    """One callback that calls them all, the first one first."""
    if len(callbacks) == 1:
        return callbacks[0]

    def call(message: Any) -> None:
        for callback in callbacks:
            callback(message)

    return call
