"""Scenario files and the table of nodes they may start.

A scenario is a standard ROS parameter file: each top-level key is a node to start, below it
``ros__parameters``. It therefore serves ``fvs_launch``, ``ros2 launch`` and
``ros2 run ... --params-file`` alike. A wildcard key ``/**`` holds parameters of all nodes.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fvs_estimator_node.registry import estimator_factory
from fvs_ros.arguments import unknown
from fvs_ros.params import Parameter, ParameterError, ParameterSet
from fvs_ros.paths import find_file, share_folders
from fvs_tools import markers, recording, yaml_text
from fvs_tools.schemes import scheme

ALL_NODES = "/**"
_NAME = r"~?/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*"
_REMAP = re.compile(rf"({_NAME}:)?{_NAME}:=/?{_NAME}", re.ASCII)
#: What rclpy declares for every node.
_EVERYWHERE = ParameterSet([Parameter("use_sim_time", False, "follow /clock")])


class ScenarioError(ValueError):
    """A scenario that cannot be started; the text says why."""


@dataclass(frozen=True)
class NodeEntry:
    """One node that a scenario may start.

    Parameters
    ----------
    executable : str
        Name of the node and of its executable.
    module : str
        Python module that runs it.
    declarations : str
        Module that holds its ``PARAMETERS``.
    commands_arm : bool
        Whether it sends joint commands: such a node is stopped first, while others still listen.
    task : bool
        Whether its end ends the scenario, its exit code being the scenario's.
    observer : bool
        Whether it only looks on: such a node is stopped last, and its end ends nothing, unless it
        refuses its parameters.
    """

    executable: str
    module: str
    declarations: str
    commands_arm: bool = False
    task: bool = False
    observer: bool = False

    def parameters(self) -> ParameterSet:
        """Declared parameters."""
        return ParameterSet(importlib.import_module(self.declarations).PARAMETERS)


NODE_TABLE: dict[str, NodeEntry] = {
    entry.executable: entry
    for entry in (
        NodeEntry("fvs_sim_node", "fvs_sim_node.node", "fvs_sim_node.config"),
        NodeEntry("fvs_detector_node", "fvs_detector_node.node", "fvs_detector_node.config"),
        NodeEntry("fvs_estimator_node", "fvs_estimator_node.node", "fvs_estimator_node.config"),
        NodeEntry(
            "fvs_controller_node",
            "fvs_controller_node.node",
            "fvs_controller_node.config",
            commands_arm=True,
        ),
        NodeEntry(
            "fvs_collector_node",
            "fvs_estimator_node.collector_node",
            "fvs_estimator_node.collector_config",
            commands_arm=True,
            task=True,
        ),
        NodeEntry("fvs_demo_node", "fvs_tools.demo_node", "fvs_tools.demo", task=True),
        NodeEntry(
            "fvs_dashboard",
            "fvs_dashboard.dashboard_node",
            "fvs_dashboard.config",
            observer=True,
        ),
        NodeEntry(markers.NODE, "fvs_tools.markers_node", "fvs_tools.markers", observer=True),
        NodeEntry(recording.NODE, "fvs_tools.recorder_node", "fvs_tools.recording", observer=True),
    )
}


@dataclass(frozen=True)
class Scenario:
    """Nodes to start and their parameters, checked against the declarations.

    Parameters
    ----------
    path : Path
        The file.
    parameters : mapping of str to mapping
        Node name -> parameter name -> value, wildcard parameters merged in.
    """

    path: Path
    parameters: Mapping[str, Mapping[str, Any]]

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes, in the file's order."""
        return list(self.parameters)

    @property
    def task(self) -> str | None:
        """The node whose end ends the scenario, if there is one."""
        return next((name for name in self.nodes if NODE_TABLE[name].task), None)

    def with_overrides(self, overrides: list[str]) -> Scenario:
        """The scenario with ``name:=value`` or ``node:name:=value`` put in.

        Without a node, the value goes to every node of the scenario that has the parameter.

        Raises
        ------
        ScenarioError
            If an override is malformed, unknown, or has a wrong value.
        """
        parameters = {node: dict(values) for node, values in self.parameters.items()}
        for override in overrides:
            key, separator, text = override.partition(":=")
            node, _, name = key.rpartition(":")
            if not separator or not name:
                raise ScenarioError(f"'{override}' is not of the form name:=value")
            if node and node not in parameters:
                raise ScenarioError(unknown(f"node of {self.path.name}", node, parameters))
            targets = [node] if node else [n for n in parameters if _declares(n, name)]
            if not targets:
                every = {one.name for n in parameters for one in NODE_TABLE[n].parameters()}
                kind = f"parameter of {self.path.name} ({', '.join(parameters)})"
                raise ScenarioError(unknown(kind, name, sorted(every)))
            try:
                value = yaml_text.read(text)
            except ValueError as error:
                raise ScenarioError(
                    f"'{override[: yaml_text.QUOTED]}' has a value that is no YAML: {error}"
                ) from error
            for target in targets:
                parameters[target][name] = value
        return Scenario(self.path, _checked(self.path, parameters))

    def with_scheme(self, name: str) -> Scenario:
        """The scenario with the estimator's method, the control law and more of a scheme put in.

        Raises
        ------
        ScenarioError
            If the scheme is unknown, or the scenario lacks one of the two nodes.
        """
        try:
            chosen = scheme(name)
        except ValueError as error:
            raise ScenarioError(str(error)) from error
        values: dict[str, dict[str, Any]] = {
            "fvs_estimator_node": {"method": chosen.method, **chosen.estimator_values},
            "fvs_controller_node": {"law": chosen.law, **chosen.controller_values},
        }
        missing = [node for node in values if node not in self.parameters]
        if missing:
            raise ScenarioError(
                f"scheme {name} needs {' and '.join(missing)}, which {self.path.name} "
                f"({', '.join(self.parameters)}) does not start"
            )
        return self.with_overrides(
            [
                f"{node}:{parameter}:={json.dumps(value)}"
                for node, wanted in values.items()
                for parameter, value in wanted.items()
            ]
        )

    def with_recording(self, folder: str, images: bool) -> Scenario:
        """The scenario with a recorder, which starts before the other nodes, and with markers.

        Parameters
        ----------
        folder : str
            Where the bag goes.
        images : bool
            Whether images are recorded, too.

        Raises
        ------
        ScenarioError
            If the folder exists, or what writes bags is not installed.
        """
        try:
            recording.check_folder(Path(folder).expanduser())
            recording.check_installed()
        except recording.RecordingError as error:
            raise ScenarioError(str(error)) from error
        others = {name: one for name, one in self.parameters.items() if name != recording.NODE}
        values = {
            **self._of_the_loop(),
            **self.parameters.get(recording.NODE, {}),
            "output_dir": folder,
            "images": images,
            "scenario": self.to_params_yaml(),
        }
        return Scenario(self.path, {recording.NODE: values, **others}).with_markers()

    def with_markers(self) -> Scenario:
        """The scenario with a node that shows the loop in RViz and Foxglove."""
        values = {**self._of_the_loop(), **self.parameters.get(markers.NODE, {})}
        return Scenario(self.path, {**self.parameters, markers.NODE: values})

    def _of_the_loop(self) -> dict[str, Any]:
        """Parameters that whoever looks on shares with the loop."""
        controller = self.parameters.get("fvs_controller_node", {})
        frame = {name: controller[name] for name in ("feature_frame",) if name in controller}
        return {"use_sim_time": self._simulated_time(), **frame}

    def _simulated_time(self) -> bool:
        return any(one.get("use_sim_time", False) for one in self.parameters.values())

    def check_models(self) -> None:
        """Find out before anything starts that a model is missing.

        Raises
        ------
        ScenarioError
            If a node needs one that is not there.
        """
        for node in self.nodes:
            declared = NODE_TABLE[node].parameters()
            given = {n: v for n, v in self.parameters[node].items() if n in declared}
            values = declared.values(given)
            needed = bool(values.get("model_path"))
            if needed and "method" in values:
                needed = estimator_factory(values["method"]).needs_model(values)
            if needed:
                try:
                    find_file(values["model_path"])
                except FileNotFoundError as error:
                    raise ScenarioError(
                        f"{node} needs a model: {error}; train one with fvs_train"
                    ) from error

    def to_params_yaml(self) -> str:
        """ROS parameter file that holds in any namespace."""
        return yaml.safe_dump(
            {
                f"/**/{node}": {"ros__parameters": dict(values)}
                for node, values in self.parameters.items()
            },
            sort_keys=False,
        )


def scenario_names() -> dict[str, str]:
    """The project's own scenarios, each with the first sentence of its file."""
    found: dict[str, str] = {}
    for path in sorted(path for share in share_folders() for path in share.glob("config/*.yaml")):
        words = path.read_text(encoding="utf-8").partition("\n\n")[0].replace("\n#", "")
        found.setdefault(path.stem, words.removeprefix("# ").partition(". ")[0].rstrip(".") + ".")
    return found


def load_scenario(name: str) -> Scenario:
    """Read and check a scenario.

    Parameters
    ----------
    name : str
        Path of a YAML file, or the name of one in the project's ``config`` folder
        (``demo`` or ``demo.yaml``).

    Raises
    ------
    ScenarioError
        If the file is missing, is no scenario, or holds an unknown node or parameter.
    """
    try:
        path = find_file(name if Path(name).suffix else f"{name}.yaml")
        content = yaml_text.read_file(path)
    except FileNotFoundError as error:
        named = name == Path(name).stem
        text = unknown("scenario", name, scenario_names()) if named else str(error)
        raise ScenarioError(text) from error
    except (OSError, ValueError, RuntimeError) as error:
        raise ScenarioError(f"cannot read scenario {name}: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ScenarioError(f"scenario {path} must map node names to ros__parameters")
    sections: dict[str, dict[str, Any]] = {}
    for key, section in content.items():
        values = section.get("ros__parameters") if isinstance(section, dict) else None
        if not isinstance(values, dict) or len(section) != 1:
            raise ScenarioError(f"'{key}' in {path} must hold ros__parameters and nothing else")
        sections[key] = values
    common = sections.pop(ALL_NODES, {})
    if not sections:
        raise ScenarioError(f"scenario {path} names no node; known are {', '.join(NODE_TABLE)}")
    for node in sections:
        if node not in NODE_TABLE:
            raise ScenarioError(f"scenario {path}: {unknown('node', node, NODE_TABLE)}")
    parameters = {}
    for node, values in sections.items():
        shared = {name: value for name, value in common.items() if _declares(node, name)}
        parameters[node] = {**shared, **values}
    return Scenario(path, _checked(path, parameters))


def enclave_arguments(node: str, namespace: str, environment: Mapping[str, str]) -> list[str]:
    """ROS arguments that name a node's SROS2 enclave, where security is on; else none.

    An enclave is named like its node, as in ``config/sros2/policy.xml``.
    """
    if environment.get("ROS_SECURITY_ENABLE", "").lower() != "true":
        return []
    return ["--enclave", "/".join(["", *filter(None, [namespace.strip("/")]), node])]


def checked_remap(text: str) -> str:
    """A remap rule ``from:=to`` (or ``node:from:=to``), as ROS takes it.

    Raises
    ------
    ScenarioError
        If it is none.
    """
    if not _REMAP.fullmatch(text):
        raise ScenarioError(f"'{text}' is not of the form from_topic:=to_topic")
    return text


def _declares(node: str, name: str) -> bool:
    if name in _EVERYWHERE:
        return True
    return node in NODE_TABLE and name in NODE_TABLE[node].parameters()


def _checked(path: Path, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    checked: dict[str, dict[str, Any]] = {}
    for node, values in parameters.items():
        try:
            declared = ParameterSet([*NODE_TABLE[node].parameters(), *_EVERYWHERE])
            checked[node] = declared.checked(values)
        except ParameterError as error:
            raise ScenarioError(f"{node} in {path.name}: {error}") from error
    return checked
