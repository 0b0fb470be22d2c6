"""Parameters of the recorder, and what a recording holds. ``bag.py`` writes it."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path

from fvs_ros.arguments import how_to_install
from fvs_ros.params import Parameters, parameter
from fvs_ros.paths import output_file


@dataclass(frozen=True)
class RecorderConfig(Parameters):
    """Parameters of ``fvs_recorder_node``."""

    bag_dir: str = parameter(
        "out/recording",
        "folder of the bag, which must not exist yet: metadata.yaml and one .mcap file",
    )
    images: bool = parameter(
        True, "record images; simulator and detector draw them only for a subscriber"
    )
    scenario: str = parameter("", "running scenario as YAML, stored in the bag")


PARAMETERS = RecorderConfig.declared()

#: Topics that are left out without images, and that have a shorter queue.
LARGE = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
)


def check_recording(folder: Path) -> None:
    """Raise a ``ValueError`` where a recording into a folder cannot begin."""
    if os.path.lexists(folder):
        raise ValueError(f"cannot record into {folder}: it exists already; name a new folder")
    if importlib.util.find_spec("rosbags") is None:
        raise ValueError(
            "recording needs rosbags, which is missing: "
            f"{how_to_install('record,lab', ['rosbags'])}"
        )
    output_file(folder)


def is_recorded(topic: str, message_type: str, images: bool) -> bool:
    """Whether a topic of the graph goes into the bag; hidden ones (``/_``) do not."""
    return "/_" not in topic and (images or message_type not in LARGE)
