"""``python -m fvs_tools.reference``: writes the pages that follow from the declarations.

``docs/reference.md`` is made from the topics, services, parameters, reasons and exit codes that the
code declares, ``config/sros2/policy.xml`` from the topics and services. Both are committed; a test
compares them with what would be written now.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fvs_controller_node.config import LAWS, SupervisorConfig
from fvs_controller_node.reasons import Reason
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import contract, stop, topics
from fvs_ros.params import Parameter
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_ros.topics import NODES, Topic
from fvs_tools.scenario import NODE_TABLE

PAGE, POLICY = "docs/reference.md", "config/sros2/policy.xml"
COMMAND = "python -m fvs_tools.reference"

#: A field of a reason's text, and its name without the unit.
_FIELD = re.compile(r"\{(\w+?)(?:_(?:mm|m|s|rad|m_s|rad_s|deg|hz|percent))?(?::[^}]*)?\}")
#: A topic, service or parameter within a sentence.
_NAME = re.compile(r"(?<![\w`/~^.*)])(~?/[a-z]\w*(?:/\w+)*|[a-z]\w*_\w+)(?![\w`/*(])")

#: The enclave for an operator's tools (``ros2 topic``, ``ros2 param``, RViz). It may read
#: everything, set parameters and targets and call services, but not send joint commands.
OPERATOR = "fvs_operator"


def page() -> str:
    """The whole of ``docs/reference.md``."""
    functions = (sentence, readable, plain_type, default_text, allowed, links, quality, condition)
    named = {one.__name__: one for one in (*functions, shared_parameters, parameter_groups)}
    return _rendered(
        "reference.md.jinja", named, NODES=NODES, Reason=Reason, stop=stop, TOPICS=contract.TOPICS
    )


def _rendered(template: str, functions: Mapping[str, Callable], **values: Any) -> str:
    """A template of this folder, in which functions are filters, too."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters.update(functions)
    return environment.get_template(template).render(**functions, **values)


# --- topics ---


def plain_type(name: str) -> str:
    """``sensor_msgs/JointState``, as people write it."""
    return name.replace("/msg/", "/").replace("/srv/", "/")


def links(nodes: Iterable[str], other: str = "") -> str:
    """Nodes, and who else, with links to their parameters."""
    names = {node: node.removeprefix("fvs_").removesuffix("_node") for node in nodes}
    if len(names) == len(NODES):
        return "every node"
    words = [f"[{name}](#{node})" for node, name in names.items()]
    return ", ".join([*words, other] if other else words)


def quality(topic: Topic) -> str:
    """Quality of service that publishers offer and that subscribers ask for."""
    ends = topic.publishers, topic.subscribers
    words = [{qos.value: None for end in one.values() for qos in end.qos} for one in ends]
    return " → ".join(" or ".join(one) for one in words).lstrip().removesuffix(" → ")


def condition(topic: Topic) -> str:
    """Parameter values with which all of its nodes have a topic, as a sentence; empty if always."""
    ends = [end.given.items() for end in (*topic.publishers.values(), *topic.subscribers.values())]
    common = [item for item in ends[0] if all(item in end for end in ends)]
    return "".join(f" With `{name}: {_value(value)}`." for name, value in common)


# --- parameters ---


def _by_meaning() -> list[dict[str, Parameter]]:
    """Each parameter, by the nodes that have it alike, live or not."""
    found: dict[str, dict[str, Parameter]] = {}
    for node, entry in NODE_TABLE.items():
        for one in entry.parameters():
            found.setdefault(repr(replace(one, live=False)), {})[node] = one
    return list(found.values())


def shared_parameters() -> list[tuple[Parameter, list[str], list[str]]]:
    """Parameters of several nodes: one, its nodes, and those in which it is live."""
    return [
        (next(iter(nodes.values())), list(nodes), [node for node in nodes if nodes[node].live])
        for nodes in _by_meaning()
        if len(nodes) > 1
    ]


def parameter_groups(node: str) -> dict[str, list[Parameter]]:
    """Parameters of one node, then those of one method or one law, by the end of their title."""
    of_all = {one.name for one in SupervisorConfig.declared()}
    owners: dict[str, list[str]] = {}
    for law, kind in LAWS.items():
        for parameter in kind.Gains.declared():
            owners.setdefault(parameter.name, []).append(f"`{law}`")
    groups: dict[str, list[Parameter]] = {}
    for parameter in (nodes[node] for nodes in _by_meaning() if list(nodes) == [node]):
        prefix, dot, _ = parameter.name.rpartition(".")
        methods = [f"`{name}`" for name, kind in ESTIMATORS.items() if kind.group == prefix]
        title = f" of method {', '.join(methods)}" if dot else ""
        if node == topics.CONTROLLER and parameter.name in owners.keys() - of_all:
            title = f" of law {', '.join(owners[parameter.name])}"
        groups.setdefault(title, []).append(parameter)
    return groups


def allowed(parameter: Parameter) -> str:
    """Values of a parameter, without words for what its default shows."""
    text = parameter.expected()
    return (
        "" if parameter.kind is bool else text.removeprefix("number from ").removeprefix("one of ")
    )


def sentence(text: str) -> str:
    """A description with a capital letter, a full stop, and ROS names set as code."""
    text = text.strip()
    if text.partition(" ")[0].strip(":,;").isalpha():  # names and symbols stay
        text = text[:1].upper() + text[1:]
    text = _NAME.sub(r"`\1`", text).replace("|", r"\|")
    return text if text.endswith((".", "!", "?")) else f"{text}."


def default_text(value: Any) -> str:
    """A default value as code."""
    cells = value if isinstance(value, list) else [value]
    return ", ".join(f"`{_value(one)}`" for one in cells if one != "") or "empty"


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def readable(template: str) -> str:
    """A format string with its fields as words in italics, without their units."""
    return _FIELD.sub(lambda field: f"*{field[1].replace('_', ' ')}*", template)


# --- access rules ---


def policy(namespace: str = "") -> str:
    """The SROS2 policy of nodes in a namespace: who may publish, subscribe and serve what (XML)."""
    enclaves, everything, services = {}, set(topics.EVERY_NODE_PUBLISHES), set()
    for name, node in NODES.items():
        published = {topic.name for topic in contract.publishers(name)}
        subscribed = {topic.name for topic in contract.subscribers(name)}
        if node.subscribes_to_all:
            subscribed.add("/*")
        served = {*node.serves, *topics.EVERY_NODE_SERVES}
        enclaves[name] = _rules(published, subscribed, served, node.calls)
        everything |= {one.replace("~", name, 1) for one in published}
        services |= {one.replace("~", name, 1) for one in served}
    sent = {topic.name for topic in contract.TOPICS if topic.also_from == topics.YOU}
    enclaves[OPERATOR] = _rules(sent, everything, (), services)
    names = {"resolve": topics.resolve}
    return _rendered("policy.xml.jinja", names, enclaves=enclaves, namespace=namespace.strip("/"))


def _rules(
    published: Iterable[str],
    subscribed: Iterable[str],
    served: Iterable[str],
    called: Iterable[str],
) -> dict[tuple[str, str], Iterable[str]]:
    """What one node may do: names by kind and verb."""
    declared, *others = topics.CAMERA_PREFIXES  # a camera is looked for under each
    cameras = [name.partition("/")[2] for name in subscribed if name.startswith(f"{declared}/")]
    cameras = [f"{other}/{name}" for other in others for name in cameras]
    return {
        ("topic", "publish"): {*published, *topics.EVERY_NODE_PUBLISHES},
        ("topic", "subscribe"): {*subscribed, *cameras, *topics.EVERY_NODE_SUBSCRIBES},
        ("service", "reply"): served,
        ("service", "request"): called,
    }


# --- program ---


def written() -> dict[str, str]:
    """What is generated: path within the source tree -> text."""
    return {PAGE: page(), POLICY: policy()}


def main(argv: list[str] | None = None) -> int:
    """Write the generated files, or one policy to anywhere."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.add_argument("-p", "--policy", type=Path, help="write the SROS2 policy alone, to there")
    parser.add_argument("-n", "--namespace", default="", help="of the nodes (with --policy)")
    arguments = parser.parse_args(argv)
    if arguments.policy is not None:
        arguments.policy.write_text(policy(arguments.namespace), encoding="utf-8")
        return EXIT_OK
    root = Path(__file__).resolve().parents[1]
    if not (root / "package.xml").is_file():
        print(f"{PAGE} is written in the source tree only; here, use --policy", file=sys.stderr)
        return EXIT_BAD_INPUT
    for name, text in written().items():
        (root / name).write_text(text, encoding="utf-8")
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
