"""The viewers' files name topics that exist."""

import re
from pathlib import Path

import yaml

from fvs_controller_node.loop import ServoLoop
from fvs_ros import contract, topics

CONFIG = Path(__file__).resolve().parents[2] / "config"


def known_topics():
    return {
        topics.resolve(topic.name, node): topic.type
        for topic in contract.TOPICS
        for node in topic.publishers
    }


def test_rviz_shows_topics_that_exist_with_their_types():
    manager = yaml.safe_load((CONFIG / "fvs.rviz").read_text("utf-8"))["Visualization Manager"]
    types = {
        "MarkerArray": "visualization_msgs/msg/MarkerArray",
        "Image": "sensor_msgs/msg/Image",
        "RobotModel": "std_msgs/msg/String",
    }
    named = {}
    for display in manager["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic:
            kind = display["Class"].removeprefix("rviz_default_plugins/")
            named["/" + topic["Value"]] = types[kind]  # relative: RViz may run in a namespace
    assert len(named) == 4
    assert named.items() <= known_topics().items()
    assert manager["Global Options"]["Fixed Frame"] == "base_link"


def test_foxglove_shows_topics_and_numbers_that_exist():
    text = (CONFIG / "foxglove.json").read_text("utf-8")
    found = set(re.findall(r'"(/[\w/]+)', text))
    assert {"/markers", "/robot_description", "/fvs_controller_node/status"} <= found
    assert found <= set(known_topics())
    keys = set(re.findall(r'key==\\"(\w+)\\"', text))
    assert "error_m" in keys
    assert keys <= ServoLoop().status_values(0.0).keys()
