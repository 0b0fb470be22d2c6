"""Writer of a rosbag2: serialised messages in an MCAP file.

ROS 2 Jazzy and later read it (``ros2 bag info``, ``ros2 bag play``), as do Foxglove, PlotJuggler
and ``fvs_experiments replay``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from rosbags import interfaces
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

#: The types of messages that a bag of Jazzy may hold.
TYPES = get_typestore(Stores.ROS2_JAZZY)
#: What writing into a bag may raise.
ERRORS: Final = (OSError, WriterError)


class Message(NamedTuple):
    """One message as it came: its topic's full name, type, arrival, and bytes on the wire (CDR)."""

    topic: str
    message_type: str
    stamp_ns: int
    data: bytes


class SimulatedTime:
    """Restamps messages with the simulated time of their arrival, from ``/clock``.

    Messages before the first ``/clock`` wait for it and get its time. Without any ``/clock`` all
    keep the system time.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._held: list[Message] = []
        self._held_bytes = 0

    def stamped(self, message: Message) -> list[Message]:
        """Messages whose time is known now; to be called in the order of arrival."""
        if message.message_type == "rosgraph_msgs/msg/Clock":
            content: Any = TYPES.deserialize_cdr(message.data, message.message_type)
            self._now_ns = content.clock.sec * 10**9 + content.clock.nanosec
        self._held.append(message)
        self._held_bytes += len(message.data)
        waits = self._now_ns is None and self._held_bytes <= 64 * 2**20
        return [] if waits else self.rest()

    def rest(self) -> list[Message]:
        """Release the waiting messages, at the end or at the memory limit."""
        released, self._held = self._held, []
        if self._now_ns is None:
            return released
        return [message._replace(stamp_ns=self._now_ns) for message in released]


class Bag:
    """Writes one bag in a new folder; a topic is added with its first message.

    ``notes`` are stored in the metadata, as ``custom_data``.
    """

    def __init__(self, folder: Path, notes: Mapping[str, str]) -> None:
        # Version 9 of rosbag2's format is that of ROS 2 Jazzy.
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        # Whole chunks of the file, as every reader of MCAP knows it: 1 MB at a time, or less.
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in notes.items():
            self._writer.set_custom_data(key, value)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self._chunk_ns = 0
        #: Messages by topic.
        self.counts: dict[str, int] = {}

    def write(self, message: Message, profiles: Iterable[Any] = ()) -> None:
        """Append a message; with a topic's first, the ``QoSProfile`` of each of its publishers."""
        topic, stamp_ns = message.topic, message.stamp_ns
        if topic not in self._connections:
            offered = dict.fromkeys(map(_bag_qos, profiles))  # each kind once
            self._connections[topic] = self._writer.add_connection(
                topic, message.message_type, typestore=TYPES, offered_qos_profiles=list(offered)
            )
            self.counts[topic] = 0
        self._writer.write(self._connections[topic], stamp_ns, message.data)
        self.counts[topic] += 1
        if abs(stamp_ns - self._chunk_ns) > 10**9:  # a killed recorder loses at most this
            self._chunk_ns = stamp_ns
            storage: Any = self._writer.storage
            if storage.chunk.msgs:
                storage.close_chunk()
            storage.bio.flush()

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; if that fails, the messages remain."""
        try:
            self._writer.close()
        except ERRORS:
            with contextlib.suppress(*ERRORS):
                self._writer.abort()
            raise


def _bag_qos(profile: Any) -> interfaces.Qos:
    """Convert a publisher's ``QoSProfile`` to the bag's format, by the names of its policies."""

    def converted(name: str, value: Any) -> Any:
        if hasattr(value, "nanoseconds"):
            return interfaces.QosTime(*divmod(value.nanoseconds, 10**9))
        kind = getattr(interfaces, f"Qos{name.capitalize()}", None)
        return value if kind is None else kind[value.name]

    fields = interfaces.Qos._fields
    return interfaces.Qos(*(converted(name, getattr(profile, name)) for name in fields))
