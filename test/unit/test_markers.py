"""The viewers' files name topics that exist."""

import json
import re
from pathlib import Path

import yaml

from fvs_controller_node.loop import ServoLoop
from fvs_ros import topics

CONFIG = Path(__file__).resolve().parents[2] / "config"


def known_topics():
    return {
        topics.resolve(topic.name, node): topic.type
        for topic in topics.TOPICS
        for node in topic.publishers
    }


def strings(value):
    """Every text in a nested structure."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, one in value.items():
            yield key
            yield from strings(one)
    elif isinstance(value, list):
        for one in value:
            yield from strings(one)


def rviz():
    return yaml.safe_load((CONFIG / "fvs.rviz").read_text(encoding="utf-8"))


def foxglove():
    return json.loads((CONFIG / "foxglove.json").read_text(encoding="utf-8"))


def test_rviz_shows_topics_that_exist_with_their_types():
    displays = rviz()["Visualization Manager"]["Displays"]
    types = {
        "MarkerArray": "visualization_msgs/msg/MarkerArray",
        "Image": "sensor_msgs/msg/Image",
        "RobotModel": "std_msgs/msg/String",
    }
    named = {}
    for display in displays:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic:
            kind = display["Class"].removeprefix("rviz_default_plugins/")
            named["/" + topic["Value"]] = types[kind]  # relative: RViz may run in a namespace
    assert len(named) == 4
    assert named.items() <= known_topics().items()
    manager = rviz()["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "base_link"
    (robot,) = (one for one in manager["Displays"] if one["Class"].endswith("/RobotModel"))
    assert robot["Description Topic"]["Durability Policy"] == "Transient Local"


def test_foxglove_shows_topics_that_exist():
    found = {re.match(r"/[\w/]+", text).group() for text in strings(foxglove()) if text[:1] == "/"}
    assert {"/markers", "/robot_description", "/fvs_controller_node/status"} <= found
    assert found <= set(known_topics())


def test_foxglove_asks_for_numbers_that_the_status_has():
    keys = set(re.findall(r'key=="(\w+)"', json.dumps(foxglove()).replace('\\"', '"')))
    assert "error_m" in keys
    assert keys <= ServoLoop().status_values(0.0).keys()
