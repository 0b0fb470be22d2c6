"""``python -m fvs_tools.reference``: writes the pages that follow from the declarations.

``docs/reference.md`` is made from the topics, services, parameters, reasons and exit codes that the
code declares, ``config/sros2/policy.xml`` from the topics and services. Both are committed; a test
compares them with what would be written now.
"""

from __future__ import annotations

import argparse
import re
import string
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fvs_controller_node.config import LAWS
from fvs_controller_node.reasons import Reason
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import contract, stop, topics
from fvs_ros.params import Parameter
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_ros.topics import NODES, End, Topic
from fvs_tools.scenario import NODE_TABLE

PAGE, POLICY = "docs/reference.md", "config/sros2/policy.xml"
COMMAND = "python -m fvs_tools.reference"

#: Unit at the end of a field's name in a reason's text.
_UNIT = re.compile(r"_(?:mm|m|s|rad|m_s|rad_s|deg|hz|percent)$")
#: A topic, service or parameter within a sentence.
_NAME = re.compile(r"(?<![\w`/~^.*)])(~?/[a-z]\w*(?:/\w+)*|[a-z]\w*_\w+)(?![\w`/*(])")

#: The enclave for an operator's tools (``ros2 topic``, ``ros2 param``, RViz). It may read
#: everything, set parameters and targets and call services, but not send joint commands.
OPERATOR = "fvs_operator"


def page() -> str:
    """The whole of ``docs/reference.md``."""
    functions = (sentence, readable, plain_type, default_text, sources, sinks, only)
    named = {one.__name__: one for one in (*functions, parameter_groups)}
    return _rendered(
        "reference.md.jinja",
        named,
        NODE_TABLE=NODE_TABLE,
        Reason=Reason,
        stop=stop,
        topics=topics,
        contract=contract,
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


def sources(topic: Topic) -> str:
    """The publishers of a topic."""
    if len(topic.publishers) == len(NODES):
        return "every node"
    return " or ".join([*map(_link, topic.publishers), *filter(None, [topic.also_from])])


def sinks(topic: Topic) -> str:
    """The subscribers of a topic."""
    return ", ".join([*map(_link, topic.subscribers), *filter(None, [topic.also_to])])


def _link(node: str) -> str:
    short = node.removeprefix("fvs_").removesuffix("_node")
    return f"[{short}](#{node})"


def only(end: End) -> str:
    """The condition under which a node has this end of a topic; empty if always."""
    when = [end.later] if end.later else []
    when += [f"with `{name}: {_value(value)}`" for name, value in end.given.items()]
    return "; ".join(when)


# --- parameters ---


def parameter_groups(node: str) -> dict[str, list[Parameter]]:
    """Parameters of all, then those of one method or one law alone, by the end of their title."""
    owners: dict[str, list[str]] = {}
    for law, kind in LAWS.items():
        for parameter in kind.Gains.declared():
            owners.setdefault(parameter.name, []).append(f"`{law}`")
    groups: dict[str, list[Parameter]] = {"": []}
    for parameter in NODE_TABLE[node].parameters():
        prefix, dot, _ = parameter.name.rpartition(".")
        methods = [f"`{name}`" for name, kind in ESTIMATORS.items() if kind.group == prefix]
        title = f" of method {', '.join(methods)}" if dot else ""
        if node == topics.CONTROLLER and parameter.name in owners:
            title = f" of law {', '.join(owners[parameter.name])}"
        groups.setdefault(title, []).append(parameter)
    return groups


def sentence(text: str) -> str:
    """A description with a capital letter, a full stop, and ROS names set as code."""
    text = text.strip()
    first = text.split(maxsplit=1)[0] if text else ""
    if first.endswith(":"):  # what a value means
        text = f"`{first[:-1]}`{text[len(first) - 1 :]}"
    elif "_" not in first and (len(first) != 1 or first == "a"):  # names and symbols stay
        text = text[:1].upper() + text[1:]
    text = _NAME.sub(r"`\1`", text).replace("|", r"\|")
    return text if text.endswith((".", "!", "?")) else f"{text}."


def default_text(value: Any) -> str:
    """A default value as code."""
    if value in ("", []):
        return "empty"
    if not isinstance(value, list):
        return f"`{_value(value)}`"
    # Three numbers or one text per line: a long default would widen the whole column.
    cells = [_value(one) for one in value]
    step = 1 if isinstance(value[0], str) else 3
    lines = [", ".join(cells[i : i + step]) for i in range(0, len(cells), step)]
    return "<br>".join(f"`{line}`" for line in lines)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        text = f"{value:.6g}"
        return text if re.search(r"[.e]", text) else f"{text}.0"
    return str(value)


def readable(template: str) -> str:
    """A format string with its fields as words in italics, without their units."""
    parts = []
    for literal, field, _spec, _conversion in string.Formatter().parse(template):
        words = _UNIT.sub("", field).replace("_", " ") if field else ""
        parts.append(literal + (f"*{words}*" if words else ""))
    return "".join(parts)


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
