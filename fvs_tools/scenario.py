"""Scenario files and the table of nodes they may start.

A scenario is a standard ROS parameter file: each top-level key is a node to start, below it
``ros__parameters``. A wildcard key ``/**`` holds parameters of several nodes, each of which takes
those that it has. ``ros2 run ... --params-file`` takes the file, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml

from fvs_ros import topics
from fvs_ros.arguments import unknown
from fvs_ros.params import Parameter, ParameterError, ParameterSet
from fvs_ros.paths import find_file, share_folder
from fvs_ros.yaml_text import QUOTED, read_yaml, read_yaml_file
from fvs_sim_node.robot import moving_joints, robot_of
from fvs_tools.recording import check_recording
from fvs_tools.schemes import scheme

ALL_NODES = "/**"
#: What rclpy declares for every node.
_EVERYWHERE = Parameter("use_sim_time", False, "follow /clock")

#: Parameters by name, by the name of their node.
Scenario = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class NodeEntry:
    """One node that a scenario may start."""

    module: str  # that runs it
    declares: str  # the module with its ``PARAMETERS``
    commands_arm: bool = False  # it is stopped first, while others still listen
    task: bool = False  # its end ends the scenario, its exit code being the scenario's
    #: A passive node: it is stopped last, and its end does not end the scenario, unless it refuses
    #: its parameters.
    observer: bool = False


#: By the name of node and executable.
NODE_TABLE: dict[str, NodeEntry] = {
    topics.SIM: NodeEntry("fvs_sim_node.node", "fvs_sim_node.config"),
    topics.DETECTOR: NodeEntry("fvs_detector_node.node", "fvs_detector_node.config"),
    topics.ESTIMATOR: NodeEntry("fvs_estimator_node.node", "fvs_estimator_node.registry"),
    topics.CONTROLLER: NodeEntry(
        "fvs_controller_node.node", "fvs_controller_node.config", commands_arm=True
    ),
    topics.COLLECTOR: NodeEntry(
        "fvs_estimator_node.collector_node",
        "fvs_estimator_node.collecting",
        commands_arm=True,
        task=True,
    ),
    topics.CALIBRATE: NodeEntry("fvs_tools.calibrate_node", "fvs_tools.calibration", task=True),
    topics.DEMO: NodeEntry("fvs_tools.demo_node", "fvs_tools.demo", task=True),
    topics.DASHBOARD: NodeEntry(
        "fvs_dashboard.dashboard_node", "fvs_dashboard.config", observer=True
    ),
    topics.RECORDER: NodeEntry("fvs_tools.recorder_node", "fvs_tools.recording", observer=True),
}


def load_scenario(
    name: str, overrides: Iterable[str] = (), scheme_name: str = "", record: str = ""
) -> Scenario:
    """The nodes to start, in this order, and their parameters, for a command line.

    ``name`` is a path, or the name of a scenario in ``config``. ``overrides`` are ``name:=value``
    for every node that has the parameter, or ``node:name:=value``; they win over the scheme.
    ``record`` is the folder of a bag; it adds the recorder, which starts first.

    A ``ValueError`` says what cannot be started.
    """
    path, sections = _read(name)
    common, loop = sections.pop(ALL_NODES, {}), list(sections)
    if not loop:
        raise ValueError(f"scenario {path} names no node; known are {', '.join(NODE_TABLE)}")
    if record:
        check_recording(Path(record).expanduser())
        recorder = {**sections.pop(topics.RECORDER, {}), "bag_dir": record}
        sections = {topics.RECORDER: recorder, **sections}
    for node, values in sections.items():
        if node not in NODE_TABLE:
            raise ValueError(f"scenario {path}: {unknown('node', node, NODE_TABLE)}")
        sections[node] = {**{n: v for n, v in common.items() if n in _declared(node)}, **values}
    for parameter in common:
        if not any(parameter in values for values in sections.values()):
            raise ValueError(f"scenario {path}, {ALL_NODES}: no node has a parameter {parameter}")
    if scheme_name:
        _choose_scheme(path, sections, scheme_name)
    for override in overrides:
        _override(path, sections, override)
    if record:
        if any(values.get("use_sim_time") for values in sections.values()):
            sections[topics.RECORDER]["use_sim_time"] = True
        sections[topics.RECORDER]["scenario"] = params_yaml({node: sections[node] for node in loop})
    for node, values in sections.items():
        try:
            sections[node] = _declared(node).checked(values)
        except ParameterError as error:
            raise ValueError(f"{node} in {path.name}: {error}") from error
    _name_joints(sections)
    return sections


def _name_joints(sections: Scenario) -> None:
    """Tell the nodes which joints the simulated arm has, where it is no UR5."""
    which = sections.get(topics.SIM, {})
    robot = [which.get(name, "") for name in ("robot", "urdf_path", "ball_link")]
    if any(robot):
        names = [joint.name for joint in moving_joints(robot_of(*robot))[1]]
        for node, values in sections.items():
            if "joint_names" in _declared(node):
                values.setdefault("joint_names", list(names))


def _read(name: str) -> tuple[Path, Scenario]:
    """Path of a scenario, and the parameters under each of its keys."""
    try:
        path = find_file(name if Path(name).suffix else f"{name}.yaml")
        content = read_yaml_file(path)
    except FileNotFoundError as error:
        named = name == Path(name).stem
        text = unknown("scenario", name, scenario_names()) if named else str(error)
        raise ValueError(text) from error
    except (OSError, ValueError, RuntimeError) as error:
        raise ValueError(f"cannot read scenario {name}: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ValueError(f"scenario {path} must map node names to ros__parameters")
    sections: Scenario = {}
    for key, section in content.items():
        values = section.get("ros__parameters") if isinstance(section, dict) else None
        if not isinstance(values, dict) or len(section) != 1:
            raise ValueError(f"'{key}' in {path} must hold ros__parameters and nothing else")
        sections[key] = values
    return path, sections


def _choose_scheme(path: Path, sections: Scenario, name: str) -> None:
    chosen = scheme(name)
    wanted: Scenario = {
        topics.ESTIMATOR: {"method": chosen.method, **chosen.estimator_values},
        topics.CONTROLLER: {"law": chosen.law, **chosen.controller_values},
    }
    missing = [node for node in wanted if node not in sections]
    if missing:
        raise ValueError(
            f"scheme {name} needs {' and '.join(missing)}, which {path.name} "
            f"({', '.join(sections)}) does not start"
        )
    for node, values in wanted.items():
        sections[node].update(values)


def _override(path: Path, sections: Scenario, override: str) -> None:
    """Put one ``name:=value`` or ``node:name:=value`` in."""
    key, separator, text = override.partition(":=")
    node, _, name = key.rpartition(":")
    if not separator or not name:
        raise ValueError(f"'{override}' is not of the form name:=value")
    if node and node not in sections:
        raise ValueError(unknown(f"node of {path.name}", node, sections))
    targets = [node] if node else [each for each in sections if name in _declared(each)]
    if not targets:
        every = {parameter.name for each in sections for parameter in _declared(each)}
        kind = f"parameter of {path.name} ({', '.join(sections)})"
        raise ValueError(unknown(kind, name, sorted(every)))
    if name == "output_path" and len(targets) > 1:  # they would write the same file
        raise ValueError(f"{name} is of {' and of '.join(targets)}: write {targets[0]}:{override}")
    try:
        value = read_yaml(text)
    except ValueError as error:
        raise ValueError(f"'{override[:QUOTED]}' has a value that is no YAML: {error}") from error
    for target in targets:
        sections[target][name] = value


def parameters_of(node: str) -> ParameterSet:
    """The parameters that a node of the package declares."""
    return ParameterSet(import_module(NODE_TABLE[node].declares).PARAMETERS)


def _declared(node: str) -> ParameterSet:
    return ParameterSet([*parameters_of(node), _EVERYWHERE])


def _complete(node: str, values: dict[str, Any]) -> dict[str, Any]:
    """All parameters of a node, with the values of a scenario."""
    known = parameters_of(node)
    return known.values({name: value for name, value in values.items() if name in known})


def check_controller(values: dict[str, Any]) -> None:
    """A ``ValueError`` says why the controller cannot start with the values of a scenario."""
    from fvs_controller_node.config import SupervisorConfig

    SupervisorConfig.from_values(_complete(topics.CONTROLLER, values))


def unfit_model(values: dict[str, Any]) -> ValueError | None:
    """Why the estimator cannot start with the model of a scenario; a ``ValueError`` if at all."""
    from fvs_estimator_node.registry import EstimatorConfig, create_estimator, trained_model

    every = _complete(topics.ESTIMATOR, values)
    config = EstimatorConfig.from_values(every)
    load, kind = partial(trained_model, config, every["joint_names"]), config.kind
    try:
        create_estimator(config.method, every, load, kind)
    except ValueError as error:
        return error
    return None


def params_yaml(parameters: Scenario) -> str:
    """ROS parameter file that holds in any namespace."""
    content = {f"/**/{node}": {"ros__parameters": dict(v)} for node, v in parameters.items()}
    return yaml.safe_dump(content, sort_keys=False)


def scenario_names() -> dict[str, str]:
    """The project's own scenarios, each with the first sentence of its file."""
    sentences = {}
    for path in sorted(share_folder().glob("config/*.yaml")):
        words = path.read_text(encoding="utf-8").partition("\n\n")[0].replace("\n#", "")
        sentences[path.stem] = words.removeprefix("# ").partition(". ")[0].rstrip(".") + "."
    return sentences
