"""Start a scenario's nodes: ``ros2 launch fvs_ros fvs.launch.py scenario:=demo``.

The same scenario files and the same table of nodes as ``fvs_launch``. When any node ends that does
not just look on, all end. Stop it by Ctrl-C (SIGINT); SIGTERM to ``ros2 launch`` would leave the
nodes running.
"""

import atexit
import os
import tempfile
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from fvs_ros.paths import find_file
from fvs_sim_node.robot import robot_description
from fvs_tools.scenario import (
    NODE_TABLE,
    checked_remap,
    enclave_arguments,
    load_scenario,
    params_yaml,
)

_SIMULATOR = "fvs_sim_node"

#: Name, default, description.
_ARGUMENTS = (
    ("scenario", "demo", "a scenario file, or the name of one in config/"),
    ("scheme", "", "estimator method and control law by one name; empty: the scenario's"),
    ("namespace", "", "of all nodes"),
    ("param", "", "name:=value or node:name:=value overrides, with spaces between"),
    ("remap", "", "from:=to rules for all nodes, with spaces between"),
    ("rviz", "false", "true opens RViz with config/fvs.rviz, and shows the loop in it"),
    ("record", "", "records all topics into a bag in this folder, which must not exist"),
    ("record_images", "true", "false leaves the images out of the bag"),
)


def _viewer(scenario, **common):
    """RViz, and for a simulated robot the publisher of its links; a real one's driver has it."""
    prefix = next((v["tf_prefix"] for v in scenario.values() if "tf_prefix" in v), "")
    rviz = ["-d", str(find_file("fvs.rviz")), "-f", f"{prefix}base_link"]
    actions = [Node(package="rviz2", executable="rviz2", arguments=rviz, **common)]
    if _SIMULATOR in scenario:
        values = scenario[_SIMULATOR]
        text = robot_description(values.get("urdf_path", ""), prefix)
        parameters = {
            "robot_description": ParameterValue(text, value_type=str),
            "use_sim_time": values.get("use_sim_time", False),
        }
        publisher = "robot_state_publisher"
        actions.append(
            Node(package=publisher, executable=publisher, parameters=[parameters], **common)
        )
    return actions


def _nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, *_ in _ARGUMENTS}
    rviz = given["rviz"] == "true"
    scenario = load_scenario(
        given["scenario"],
        given["param"].split(),
        given["scheme"],
        given["record"],
        images=given["record_images"] == "true",
        markers=rviz,
    )
    remaps = [tuple(checked_remap(rule).split(":=")) for rule in given["remap"].split()]
    common = {"namespace": given["namespace"], "remappings": remaps}
    handle, params_file = tempfile.mkstemp(prefix="fvs_launch_", suffix=".yaml")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(params_yaml(scenario))
    atexit.register(Path(params_file).unlink, missing_ok=True)
    actions = []
    if _SIMULATOR in scenario and "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ:
        # A simulated arm must not exchange messages with the robots of a laboratory network.
        actions.append(SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
    for name in scenario:
        end = None if NODE_TABLE[name].observer else Shutdown(reason=f"{name} ended")
        actions.append(
            Node(
                package="fvs_ros",
                executable=name,
                ros_arguments=enclave_arguments(name, given["namespace"], os.environ),
                parameters=[params_file],
                output="screen",
                emulate_tty=True,
                on_exit=end,
                **common,
            )
        )
    return [*actions, *(_viewer(scenario, **common) if rviz else [])]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in _ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])
