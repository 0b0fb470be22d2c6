"""Start a scenario's nodes: ``ros2 launch fvs_ros fvs.launch.py scenario:=demo``.

It runs ``fvs_launch``, which starts, watches and stops the nodes, and ends when it ends. However
``ros2 launch`` ends, ``fvs_launch`` gets a signal and has the arm stopped.
"""

import os

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration

from fvs_ros.paths import find_file, program
from fvs_ros.urdf import read_joints
from fvs_sim_node.robot import robot_description, robot_of
from fvs_tools.kinematics import kinematics
from fvs_tools.scenario import load_scenario

#: Name, default, description.
_ARGUMENTS = (
    ("scenario", "demo", "a scenario file, or the name of one in config/"),
    ("scheme", "", "estimator method and control law by one name; empty: the scenario's"),
    ("namespace", "", "of all nodes"),
    ("param", "", "name:=value or node:name:=value overrides, with spaces between"),
    ("remap", "", "from:=to rules for all nodes, with spaces between"),
    ("rviz", "false", "true opens RViz with config/fvs.rviz, and shows the loop in it"),
    ("record", "", "records all topics into a bag in this folder, which must not exist"),
)


def _viewer(arguments):
    """RViz, and a simulated robot's links; a real one's driver publishes them."""
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue

    remaps = [tuple(rule.split(":=")) for rule in arguments["remap"].split()]
    common = {"namespace": arguments["namespace"], "remappings": remaps}
    scenario = load_scenario(
        arguments["scenario"], arguments["param"].split(), arguments["scheme"], arguments["record"]
    )
    prefix = next((v["tf_prefix"] for v in scenario.values() if "tf_prefix" in v), "")
    actions, root = [], "base_link"
    if "fvs_sim_node" in scenario:
        values = scenario["fvs_sim_node"]
        which = [values.get(name, "") for name in ("robot", "urdf_path", "ball_link")]
        robot = robot_of(*which)
        root = kinematics(read_joints(robot.file().read_bytes()), robot.ball_link).root
        text = robot_description(robot, prefix)
        parameters = {
            "robot_description": ParameterValue(text, value_type=str),
            "use_sim_time": values.get("use_sim_time", False),
        }
        name = "robot_state_publisher"
        actions.append(Node(package=name, executable=name, parameters=[parameters], **common))
        # A simulated arm must not exchange messages with the robots of a laboratory network.
        local = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        actions.insert(0, SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", local))
    rviz = ["-d", str(find_file("fvs.rviz")), "-f", prefix + root]
    return [*actions, Node(package="rviz2", executable="rviz2", arguments=rviz, **common)]


def _nodes(context):
    arguments = {name: LaunchConfiguration(name).perform(context) for name, *_ in _ARGUMENTS}
    words = [arguments["scenario"]]
    words += [f"--{name}={arguments[name]}" for name in ("scheme", "namespace", "record")]
    for name in ("param", "remap"):
        words += [f"--{name}={rule}" for rule in arguments[name].split()]
    loop = ExecuteProcess(
        name="fvs_launch",
        cmd=[*program("fvs_tools.launcher"), *words],
        output="screen",
        # It gives commanding nodes, others and observers 5 s each, and takes any signal.
        sigterm_timeout="1",
        sigkill_timeout="20",
        on_exit=Shutdown(reason="fvs_launch ended"),
    )
    return [loop, *(_viewer(arguments) if arguments["rviz"].lower() == "true" else [])]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in _ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])
