"""Every node of the package, started for real, each alone in a namespace of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from harness import Harness

from fvs_ros import topics
from fvs_ros.topics import resolve
from fvs_tools.scenario import NODE_TABLE

#: What a node needs that runs beside others and has no one to talk to.
ALONE: dict[str, dict[str, Any]] = {
    "fvs_dashboard": {"port": 0},
    "fvs_recorder_node": {"images": False},  # nobody shall have to draw any
}


@dataclass(frozen=True)
class LoneNode:
    """One node that runs alone.

    Parameters
    ----------
    name : str
        Its name.
    namespace : str
        Its namespace, without slashes.
    given : dict
        Parameters that it was started with.
    """

    name: str
    namespace: str
    given: dict[str, Any] = field(default_factory=dict)

    @property
    def full_name(self) -> str:
        """Name with namespace."""
        return self.resolve("~")

    def resolve(self, name: str) -> str:
        """Full name of one of its topics or services."""
        return resolve(name, self.name, self.namespace)

    def values(self) -> dict[str, Any]:
        """All its parameters."""
        return NODE_TABLE[self.name].parameters().values(self.given)


def start_alone(harness: Harness, name: str, namespace: str, **parameters: Any) -> LoneNode:
    """Start a node in a namespace; ``wait_until_up`` before relying on it."""
    node = LoneNode(name, namespace, {**ALONE.get(name, {}), **parameters})
    arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
    for key, value in node.given.items():
        arguments += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
    harness.start("patient_node", NODE_TABLE[name].module, *arguments)
    return node


def wait_until_up(harness: Harness, nodes: list[LoneNode]) -> None:
    """Receive until every node has spoken, and so has made all that it makes at its start."""
    heard: list[DiagnosticArray] = harness.collect(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
    wanted = {node.full_name for node in nodes}

    def up() -> set[str]:
        spoken = {status.name for message in heard for status in message.status}
        graph = harness.node.get_node_names_and_namespaces()
        return spoken & {f"{namespace}/{name}" for name, namespace in graph}

    harness.spin_until(lambda: wanted <= up(), 90.0, f"diagnostics of {sorted(wanted)}")
