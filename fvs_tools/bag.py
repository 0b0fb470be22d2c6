"""A rosbag2 that is being written: messages as they were on the wire, in an MCAP file.

Any ROS 2 from Jazzy on reads it (``ros2 bag info``, ``ros2 bag play``), and so do Foxglove,
PlotJuggler and ``fvs_experiments replay``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    WriterError,
)
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import Stores, get_typestore

#: Of rosbag2's format, as ROS 2 Jazzy writes it.
_VERSION: Final = 9
#: The types of messages that a bag of Jazzy may hold.
TYPES = get_typestore(Stores.ROS2_JAZZY)
#: Holds the notes until ``metadata.yaml`` does: a recorder that is killed leaves it.
NOTES: Final = "notes.yaml"
#: So much of the recording, by its own time, waits in memory at most, ns: a recorder that is killed
#: loses it.
_CHUNK_NS: Final = 10**9
#: What writing into a bag may raise.
ERRORS: Final = (OSError, WriterError)


def knows(message_type: str) -> bool:
    """Whether messages of a type can be described in a bag."""
    return message_type in TYPES.fielddefs


def to_bag_qos(profile: Any) -> Qos:
    """What a publisher offers, as a bag holds it; of a ``QoSProfile``, read by its names."""

    def time(duration: Any) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 10**9))

    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=time(profile.deadline),
        lifespan=time(profile.lifespan),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
    )


class Bag:
    """Writes one bag; a topic is in it from its first message on.

    Parameters
    ----------
    folder : Path
        Made here.
    notes : mapping of str to str
        What travels beside the messages.

    Raises
    ------
    OSError
        If the folder cannot be made, or not be written into.
    """

    def __init__(self, folder: Path, notes: Mapping[str, str]) -> None:
        self._writer = Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        # Whole chunks of the file, as every reader of MCAP knows it: 1 MB at a time, or less.
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in notes.items():
            self._writer.set_custom_data(key, value)
        self._writer.open()
        self._notes = folder / NOTES
        self._notes.write_text(yaml.safe_dump(dict(notes)), encoding="utf-8")
        self._connections: dict[str, Any] = {}
        self._chunk_ns: int | None = None
        #: Messages by topic.
        self.counts: dict[str, int] = {}

    def write(
        self, topic: str, message_type: str, profiles: Iterable[Any], stamp_ns: int, data: bytes
    ) -> None:
        """Append a message.

        Parameters
        ----------
        topic, message_type : str
            Its topic and type.
        profiles : iterable of QoSProfile
            What the topic's publishers offer; looked at with the first message.
        stamp_ns : int
            Time of its arrival, ns.
        data : bytes
            The message, serialised (CDR).

        Raises
        ------
        OSError or WriterError
            If it cannot be written.
        """
        connection = self._connections.get(topic)
        if connection is None:
            offered = dict.fromkeys(map(to_bag_qos, profiles))  # each kind once
            connection = self._writer.add_connection(
                topic, message_type, typestore=TYPES, offered_qos_profiles=list(offered)
            )
            self._connections[topic] = connection
            self.counts[topic] = 0
        self._writer.write(connection, stamp_ns, data)
        self.counts[topic] += 1
        if self._chunk_ns is None:
            self._chunk_ns = stamp_ns
        elif abs(stamp_ns - self._chunk_ns) > _CHUNK_NS:
            self._chunk_ns = stamp_ns
            self._hand_over()

    def _hand_over(self) -> None:
        """Give the system all that was written until now."""
        storage = self._writer.storage
        if isinstance(storage, McapWriter):
            if storage.chunk.msgs:
                storage.close_chunk()
            storage.bio.flush()

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; one of ``ERRORS`` if that fails."""
        self._writer.close()
        self._notes.unlink(missing_ok=True)

    def abandon(self) -> None:
        """Close after an error; what was written stays, without an index."""
        with contextlib.suppress(*ERRORS):
            self._writer.abort()
