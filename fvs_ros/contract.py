"""All topics of the package, and those of a node."""

from __future__ import annotations

from fvs_ros.kinds import KINDS
from fvs_ros.topics import COMMON, End, Topic

TOPICS: tuple[Topic, ...] = (*COMMON, *(topic for kind in KINDS.values() for topic in kind.topics))


def publishers(node: str) -> dict[Topic, End]:
    """What a node publishes."""
    return {topic: topic.publishers[node] for topic in TOPICS if node in topic.publishers}


def subscribers(node: str) -> dict[Topic, End]:
    """What a node subscribes to."""
    return {topic: topic.subscribers[node] for topic in TOPICS if node in topic.subscribers}
