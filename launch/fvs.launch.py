"""Start a scenario's nodes: ``ros2 launch fvs_ros fvs.launch.py scenario:=demo``.

The same scenario files and the same table of nodes as ``fvs_launch``. When any node ends, all end.
Stop it by Ctrl-C (SIGINT); SIGTERM to ``ros2 launch`` would leave the nodes running.
"""

import atexit
import os
import tempfile
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fvs_ros.apps.scenario import (
    NODE_TABLE,
    checked_remap,
    enclave_arguments,
    load_scenario,
)


def _params_file(scenario) -> str:
    """The scenario's checked parameters as a file that holds in any namespace."""
    handle, name = tempfile.mkstemp(prefix="fvs_launch_", suffix=".yaml")
    os.close(handle)
    path = Path(name)
    path.write_text(scenario.to_params_yaml(), encoding="utf-8")
    atexit.register(path.unlink, missing_ok=True)
    return name


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
    params_file = _params_file(scenario)
    actions = []
    if "fvs_sim_node" in scenario.nodes and "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ:
        # A simulated arm must not hear, or be heard by, the robots of a laboratory network.
        actions.append(SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
    for name in scenario.nodes:
        actions.append(
            Node(
                package="fvs_ros",
                executable=NODE_TABLE[name].executable,
                namespace=namespace,
                ros_arguments=enclave_arguments(name, namespace, os.environ),
                parameters=[params_file],
                remappings=remappings,
                output="screen",
                emulate_tty=True,
                on_exit=Shutdown(reason=f"{name} ended"),
            )
        )
    return actions


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
            OpaqueFunction(function=_nodes),
        ]
    )
