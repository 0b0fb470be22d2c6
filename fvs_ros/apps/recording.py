"""What a recording holds: its parameters, which topics, with which quality of service.

The bag itself is written in ``bag.py``, the node is ``recorder_node.py``.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fvs_ros.core.params import Parameter

NODE = "fvs_recorder_node"

PARAMETERS = (
    Parameter(
        "output_dir",
        "out/recording",
        "folder of the bag, which must not exist yet: metadata.yaml and one .mcap file",
    ),
    Parameter(
        "images",
        True,
        "whether images are recorded, too; the simulator and the detector draw theirs only for "
        "somebody who listens",
    ),
    Parameter(
        "smallest_free_mb",
        200.0,
        "the recording ends, complete, when its disk has less space left than this",
        minimum=0.0,
    ),
    Parameter("scenario", "", "what was started, as YAML: kept in the bag beside the messages"),
)

#: What is left out without images.
_LARGE = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
)
#: How many messages of a topic may wait to be written, and how many of a large one.
_DEPTH, _DEPTH_LARGE = 4000, 60
#: So many messages of one topic are remembered, to know those that came twice.
_REMEMBERED = 4096


class RecordingError(ValueError):
    """A recording that cannot begin; the text says why."""


def check_folder(folder: Path) -> None:
    """Refuse a folder that exists: a recording is never mixed with another.

    Raises
    ------
    RecordingError
        If it exists, or something else stands in its way.
    """
    try:
        exists = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise RecordingError(f"cannot record into {folder}: {error.strerror}") from error
    if exists:
        raise RecordingError(f"cannot record into {folder}: it exists already; name a new folder")
    for parent in folder.absolute().parents:
        if parent.exists():
            if not parent.is_dir():
                raise RecordingError(f"cannot record into {folder}: {parent} is no folder")
            return


def is_recorded(topic: str, message_type: str, images: bool) -> bool:
    """Whether a topic of the graph goes into the bag.

    Parameters
    ----------
    topic : str
        Its full name; hidden ones (a part that begins with ``_``) are left out.
    message_type : str
        Such as ``sensor_msgs/msg/Image``.
    images : bool
        Whether images are recorded.
    """
    hidden = any(part.startswith("_") for part in topic.split("/"))
    return not hidden and (images or message_type not in _LARGE)


def queue_depth(message_type: str) -> int:
    """How many messages may wait to be written."""
    return _DEPTH_LARGE if message_type in _LARGE else _DEPTH


@dataclass(frozen=True)
class Request:
    """What a subscription asks of publishers.

    Parameters
    ----------
    reliable : bool
        Whether lost messages are sent again.
    latched : bool
        Whether messages from before the subscription are wanted.
    """

    reliable: bool
    latched: bool


def missing_requests(offered: Iterable[Request], have: Collection[Request]) -> list[Request]:
    """What must still be asked for, so that all that publishers offer is heard at its best.

    A subscription that asks for less hears a publisher that offers more, but not the other way
    round; so each kind of publisher gets a subscription of its own, and what comes twice is told
    by :class:`Doubles`.
    """
    return sorted(set(offered) - set(have), key=lambda one: (one.reliable, one.latched))


class Doubles:
    """Tells messages of one topic that came twice, over two subscriptions."""

    def __init__(self) -> None:
        self._seen: dict[tuple[int, int], None] = {}

    def again(self, sent_ns: int, data: bytes) -> bool:
        """Whether this message, with the time at which it was sent, came before."""
        key = (sent_ns, hash(data))
        if key in self._seen:
            return True
        self._seen[key] = None
        if len(self._seen) > _REMEMBERED:
            del self._seen[next(iter(self._seen))]
        return False


@dataclass(frozen=True)
class Message:
    """One message as it came.

    Parameters
    ----------
    topic, message_type : str
        Its topic's full name, and type.
    received_ns : int
        When it arrived, system time, ns.
    data : bytes
        As it was on the wire.
    """

    topic: str
    message_type: str
    received_ns: int
    data: bytes


class SimulatedTime:
    """Gives messages the simulated time of their arrival, by the ``/clock`` messages among them."""

    def __init__(self) -> None:
        self._now_ns = 0

    def stamp_ns(self, message: Message) -> int:
        """Simulated time of a message, ns; to be called in the order of arrival."""
        if message.message_type == "rosgraph_msgs/msg/Clock":
            # CDR: four bytes that say how, then seconds and nanoseconds.
            order = "<" if message.data[1] & 1 else ">"
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", message.data, 4)
            self._now_ns = seconds * 10**9 + nanoseconds
        return self._now_ns


def notes(scenario: str, version: str) -> Mapping[str, str]:
    """What travels in the bag beside the messages: its ``custom_data``."""
    return {"fvs_ros_version": version, "scenario": scenario}
