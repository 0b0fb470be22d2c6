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
from fvs_sim_node.config import PARAMETERS as SIM_PARAMETERS
from fvs_sim_node.ur5_urdf import urdf_text
from fvs_tools.scenario import (
    NODE_TABLE,
    checked_remap,
    enclave_arguments,
    load_scenario,
)

_SIMULATOR = "fvs_sim_node"
_YES = "true"


def _params_file(scenario) -> str:
    """The scenario's checked parameters as a file that holds in any namespace."""
    handle, name = tempfile.mkstemp(prefix="fvs_launch_", suffix=".yaml")
    os.close(handle)
    path = Path(name)
    path.write_text(scenario.to_params_yaml(), encoding="utf-8")
    atexit.register(path.unlink, missing_ok=True)
    return name


def _viewer(scenario, namespace, remappings):
    """RViz, and for a simulated robot what tells it the links' places; a real one's driver does."""
    prefixes = [
        values["tf_prefix"] for values in scenario.parameters.values() if "tf_prefix" in values
    ]
    base = f"{prefixes[0] if prefixes else ''}base_link"
    actions = [
        Node(
            package="rviz2",
            executable="rviz2",
            namespace=namespace,
            arguments=["-d", str(find_file("fvs.rviz")), "-f", base],
            remappings=remappings,
        )
    ]
    if _SIMULATOR in scenario.nodes:
        given = scenario.parameters[_SIMULATOR]
        values = {one.name: given.get(one.name, one.default) for one in SIM_PARAMETERS}
        path = values["urdf_path"]
        text = Path(path).read_text(encoding="utf-8") if path else urdf_text(values["tf_prefix"])
        actions.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=namespace,
                remappings=remappings,
                parameters=[
                    {
                        "robot_description": ParameterValue(text, value_type=str),
                        "use_sim_time": given.get("use_sim_time", False),
                    }
                ],
            )
        )
    return actions


def _nodes(context):
    scenario = load_scenario(LaunchConfiguration("scenario").perform(context))
    scheme = LaunchConfiguration("scheme").perform(context)
    if scheme:
        scenario = scenario.with_scheme(scheme)
    namespace = LaunchConfiguration("namespace").perform(context)
    overrides = LaunchConfiguration("param").perform(context).split()
    scenario = scenario.with_overrides(overrides)
    rules = LaunchConfiguration("remap").perform(context).split()
    remappings = [tuple(checked_remap(rule).split(":=")) for rule in rules]
    record = LaunchConfiguration("record").perform(context)
    if record:
        scenario = scenario.with_recording(
            record, LaunchConfiguration("record_images").perform(context) == _YES
        )
    rviz = LaunchConfiguration("rviz").perform(context) == _YES
    if rviz:
        scenario = scenario.with_markers()
    scenario.check_models()
    params_file = _params_file(scenario)
    actions = []
    if _SIMULATOR in scenario.nodes and "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ:
        # A simulated arm must not hear, or be heard by, the robots of a laboratory network.
        actions.append(SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
    for name in scenario.nodes:
        entry = NODE_TABLE[name]
        actions.append(
            Node(
                package="fvs_ros",
                executable=entry.executable,
                namespace=namespace,
                ros_arguments=enclave_arguments(name, namespace, os.environ),
                parameters=[params_file],
                remappings=remappings,
                output="screen",
                emulate_tty=True,
                on_exit=None if entry.observer else Shutdown(reason=f"{name} ended"),
            )
        )
    return [*actions, *(_viewer(scenario, namespace, remappings) if rviz else [])]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "scenario",
                default_value="demo",
                description="a scenario file, or the name of one in config/",
            ),
            DeclareLaunchArgument(
                "scheme",
                default_value="",
                description="estimator method and control law by one name; empty: the scenario's",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="of all nodes"),
            DeclareLaunchArgument(
                "param",
                default_value="",
                description="name:=value or node:name:=value overrides, with spaces between",
            ),
            DeclareLaunchArgument(
                "remap",
                default_value="",
                description="from:=to rules for all nodes, with spaces between",
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                description="true opens RViz with config/fvs.rviz, and shows the loop in it",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="",
                description="records all topics into a bag in this folder, which must not exist",
            ),
            DeclareLaunchArgument(
                "record_images",
                default_value="true",
                description="false leaves the images out of the bag",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
