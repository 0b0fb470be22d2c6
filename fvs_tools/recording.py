"""What a recording holds: its parameters, and which topics. ``bag.py`` writes it."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.params import Parameters, parameter
from fvs_tools.installing import how_to_install


@dataclass(frozen=True)
class RecorderConfig(Parameters):
    """Parameters of ``fvs_recorder_node``."""

    bag_dir: str = parameter(
        "out/recording",
        "folder of the bag, which must not exist yet: metadata.yaml and one .mcap file",
    )
    images: bool = parameter(
        True, "whether images are recorded; simulator and detector draw them only for a listener"
    )
    feature_frame: str = parameter(CAMERA_FRAME, "frame of ball and images")
    scenario: str = parameter("", "what was started, as YAML: kept in the bag beside the messages")


PARAMETERS = RecorderConfig.declared()

#: What is left out without images, and waits in a shorter queue.
LARGE = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
)


class RecordingError(ValueError):
    """A recording that cannot begin; the text says why."""


def check(folder: Path) -> None:
    """Refuse a folder that exists, and a machine without the library that writes bags.

    Raises
    ------
    RecordingError
        If a recording into the folder cannot begin.
    """
    if os.path.lexists(folder):
        raise RecordingError(f"cannot record into {folder}: it exists already; name a new folder")
    if importlib.util.find_spec("rosbags") is None:
        raise RecordingError(
            "recording needs rosbags, which is missing: "
            f"{how_to_install('record,lab', ['rosbags'])}"
        )


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
    return "/_" not in topic and (images or message_type not in LARGE)
