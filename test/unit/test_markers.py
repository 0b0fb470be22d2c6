"""What a viewer is shown, and that the viewers' files name topics that exist."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from fvs_controller_node.config import build_loop, default_values
from fvs_controller_node.supervisor import Supervisor
from fvs_ros import topics
from fvs_tools import markers
from fvs_tools.markers import FRESH_S, Scene
from fvs_tools.scenario import load_scenario

CONFIG = Path(__file__).resolve().parents[2] / "config"
BALL = np.array([0.1, 0.2, 1.5])
STATUS = {
    "state": "SERVOING",
    "error_m": "0.0123",
    **{f"target_{axis}_m": str(value) for axis, value in zip("xyz", (0.0, 0.3, 1.4), strict=True)},
    **{f"position_{axis}_m": str(value) for axis, value in zip("xyz", BALL, strict=True)},
}


def scene():
    return Scene(ball_radius_m=0.04, trail_s=2.0)


def shown(one, now_s):
    return {shape.name: shape for shape in one.shapes(now_s)}


def test_nothing_heard_is_nothing_shown():
    assert scene().shapes(0.0) == []


def test_the_ball_is_where_it_was_seen_and_as_large_as_it_is():
    one = scene()
    one.add_ball(1.0, BALL)
    ball = shown(one, 1.1)["ball"]
    assert np.array_equal(ball.points_m, [BALL])
    assert ball.size_m == pytest.approx(0.08)


def test_a_ball_that_is_not_seen_any_more_vanishes_and_its_trail_after_it():
    one = scene()
    one.add_ball(1.0, BALL)
    one.add_ball(1.1, BALL + 0.01)
    assert set(shown(one, 1.2)) == {"ball", "trail"}
    assert set(shown(one, 1.1 + FRESH_S)) == {"trail"}
    assert shown(one, 3.2) == {}


def test_the_trail_is_as_long_as_wanted():
    one = scene()
    for step in range(50):
        one.add_ball(0.1 * step, BALL + 0.001 * step)
    trail = shown(one, 4.9)["trail"].points_m
    assert len(trail) == 20 + 1
    assert np.array_equal(trail[-1], BALL + 0.049)


def test_the_target_says_how_far_it_is():
    one = scene()
    one.add_status(1.0, STATUS)
    found = shown(one, 1.1)
    assert np.array_equal(found["target"].points_m, [[0.0, 0.3, 1.4]])
    assert found["target"].colour[3] < 1.0, "it must not hide the ball"
    assert found["distance"].text == "12.3 mm"
    assert found["distance"].points_m[0, 1] < 0.3, "above, and the camera's y points down"
    assert np.array_equal(found["predicted"].points_m, [BALL])


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"state": "HOLDING"}, "12.3 mm, holding"),
        ({"error_m": "unknown"}, "no ball"),
    ],
)
def test_the_words_beside_the_target(changed, text):
    one = scene()
    one.add_status(1.0, {**STATUS, **changed})
    assert shown(one, 1.0)["distance"].text == text


def test_without_a_target_none_is_shown():
    one = scene()
    one.add_status(1.0, {**STATUS, "target_x_m": "unknown"})
    assert set(shown(one, 1.0)) == {"predicted"}


def test_a_silent_controller_leaves_nothing():
    one = scene()
    one.add_status(1.0, STATUS)
    assert one.shapes(1.0 + FRESH_S) == []


@pytest.mark.parametrize(("rate_hz", "life_s"), [(1.0, 2.0), (2.0, 1.0), (10.0, 0.5), (30.0, 0.5)])
def test_a_marker_lives_until_it_is_said_again(rate_hz, life_s):
    assert markers.lifetime_s(rate_hz) == life_s


def test_a_scenario_with_markers_keeps_frame_and_time():
    scenario = load_scenario("servo").with_overrides(
        ["use_sim_time:=true", "fvs_controller_node:feature_frame:=eye"]
    )
    values = scenario.with_markers().parameters[markers.NODE]
    assert values == {"use_sim_time": True, "feature_frame": "eye"}


# --- RViz and Foxglove ---


def known_topics():
    found = {}
    for node, interface in topics.INTERFACES.items():
        for end in interface.publishes:
            found[topics.resolve(end.topic.name, node)] = end.topic.type
    return found


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


def test_rviz_hears_the_latched_robot_and_stands_in_its_base():
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
    said = build_loop(default_values()).status_values(0.0)
    assert Supervisor().status_values(0.0).keys() <= said.keys()
    assert keys <= said.keys()


def test_every_panel_of_foxglove_is_placed_once():
    layout = foxglove()
    panels = layout["configById"]
    placed = [one for one in strings(layout["layout"]) if "!" in one]
    for panel in panels.values():
        placed += [tab["layout"] for tab in panel.get("tabs", ())]
    assert sorted(placed) == sorted(panels)
