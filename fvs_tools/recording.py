"""What a recording holds: its parameters, which topics, with which quality of service.

The bag itself is written in ``bag.py``, the node is ``recorder_node.py``.
"""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.params import Parameter
from fvs_tools.installing import how_to_install

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
    Parameter("feature_frame", CAMERA_FRAME, "frame of ball and images"),
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
#: No more than this waits for a first /clock, bytes.
_HELD_BYTES = 64 * 2**20


class RecordingError(ValueError):
    """A recording that cannot begin; the text says why."""


def check_installed() -> None:
    """Refuse to record without the library that writes bags.

    Raises
    ------
    RecordingError
        If it is not installed.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise RecordingError(
            "recording needs rosbags, which is missing: "
            f"{how_to_install('record,lab', ['rosbags'])}"
        )


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
    """Gives messages the simulated time of their arrival, by the ``/clock`` messages among them.

    Messages from before the first ``/clock`` wait for it, and count as come with it: another time
    would be none of the simulation's. Where none comes, all stay with the system's time.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._held: list[Message] = []
        self._held_bytes = 0
        #: Whether no clock came, so that times are the system's.
        self.without_clock = False

    def stamped(self, message: Message) -> Iterator[tuple[int, Message]]:
        """Messages whose time is known now, ns; to be called in the order of arrival."""
        if self.without_clock:
            yield message.received_ns, message
            return
        if message.message_type == "rosgraph_msgs/msg/Clock":
            # CDR: four bytes that say how, then seconds and nanoseconds.
            order = "<" if message.data[1] & 1 else ">"
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", message.data, 4)
            self._now_ns = seconds * 10**9 + nanoseconds
        self._held.append(message)
        self._held_bytes += len(message.data)
        if self._now_ns is not None:
            yield from ((self._now_ns, one) for one in self._released())
        elif self._held_bytes > _HELD_BYTES:
            yield from self.rest()

    def rest(self) -> Iterator[tuple[int, Message]]:
        """What still waits, at the end, or because too much does, by the system's time."""
        if self._now_ns is None:
            self.without_clock = True
        yield from ((one.received_ns, one) for one in self._released())

    def _released(self) -> list[Message]:
        released, self._held, self._held_bytes = self._held, [], 0
        return released


def notes(scenario: str, version: str, names: Mapping[str, str]) -> Mapping[str, str]:
    """What travels in the bag beside the messages: its ``custom_data``.

    Parameters
    ----------
    scenario : str
        What was started, as YAML.
    version : str
        Of this package.
    names : mapping of str to str
        Full name of each own topic as declared -> as it is; those that differ were remapped.
    """
    told = {"fvs_ros_version": version, "scenario": scenario}
    remaps = {declared: name for declared, name in names.items() if declared != name}
    return {**told, "remaps": yaml.safe_dump(remaps)} if remaps else told
