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
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fvs_controller_node.config import LAWS
from fvs_controller_node.reasons import Reason, State, Stop
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import topics
from fvs_ros.params import Parameter
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_ros.topics import NODES, End, Node, Topic
from fvs_tools.scenario import NODE_TABLE

PAGE, POLICY = "docs/reference.md", "config/sros2/policy.xml"
COMMAND = "python -m fvs_tools.reference"

#: Unit at the end of a field's name in a reason's text.
_UNIT = re.compile(r"_(?:mm|m|s|rad|m_s|rad_s|deg|hz|percent)$")
#: A topic, service or parameter within a sentence.
_NAME = re.compile(r"(?<![\w`/~^.*)])(~?/[a-z]\w*(?:/\w+)*|[a-z]\w*_\w+)(?![\w`/*(])")

#: The enclave for a person's tools (``ros2 topic``, ``ros2 param``, RViz): sees everything, sets
#: parameters and targets, calls services, and cannot send a joint command.
OPERATOR = "fvs_operator"

# No "--" in it: XML does not allow it in a comment.
_POLICY_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<!--
  Access rules of the nodes for SROS2{where}. Written by fvs_tools/reference.py from
  fvs_ros/topics.py; docs/reference.md says how to use it.

  One enclave a node, called like the node with its namespace, and one for a person's tools.
  What is not listed is denied: above all, only two nodes may publish joint commands.

  Names hold for {holds} and without remaps. Rules for another namespace:
      python3 -m fvs_tools.reference -p policy.xml -n NAMESPACE
  With a remap, change the name here too. A robot's driver, a camera and a detector of your own
  need enclaves of their own; their rules are not here.
-->
"""

_STATES = {
    State.WAITING: "Something that a start needs is missing; zeros are sent.",
    State.READY: "A start would be accepted; zeros are sent.",
    State.SERVOING: "The law moves the arm.",
    State.HOLDING: "Held still: goes on by itself, or needs a new start, as the reason says.",
    State.FAULT: "Something was wrong that must never be; zeros at once.",
}

_STOPS = {Stop.NONE: "goes on", Stop.RAMP: "ramps to rest", Stop.AT_ONCE: "zeros at once"}

_EXIT_CODES = {
    EXIT_OK: "done, or stopped by a signal",
    EXIT_FAILURE: "an error, or a task that was not reached; the last lines say which",
    EXIT_BAD_INPUT: "a wrong parameter, argument or file; nothing was started",
}


def page() -> str:
    """The whole of ``docs/reference.md``."""
    template = Path(__file__).with_name("reference.md.in").read_text(encoding="utf-8")
    codes = [(str(code), text) for code, text in _EXIT_CODES.items()]
    return string.Template(template).substitute(
        nodes="\n".join(f"  - [{name}](#{name})" for name in NODE_TABLE),
        topics=_topics_table(),
        node_sections="\n".join(_node(name, NODES[name]) for name in NODE_TABLE),
        states=_table(("state", "meaning"), [(_code(s.value), _STATES[s]) for s in State]),
        reasons=_reasons_table(),
        exit_codes=_table(("code", "when"), codes),
    )


# --- topics and services ---


def _topics_table() -> str:
    rows = []
    for topic in topics.TOPICS:
        sources = [_link(node) for node in topic.publishers]
        if len(sources) == len(NODES):
            sources = ["every node"]
        ends = [
            " or ".join([*sources, *filter(None, [topic.also_from])]),
            ", ".join([*map(_link, topic.subscribers), *filter(None, [topic.also_to])]),
        ]
        if ends[0]:
            name = f"{_code(topic.name)}<br>{_type(topic.type)}"
            rows.append((name, *ends, sentence(topic.description)))
    return _table(("topic and type", "from", "to", "holds"), rows)


def _node(name: str, node: Node) -> str:
    parts = [f"## {name}\n", f"{node.does}\n"]
    for verb, ends in (
        ("Publishes", topics.publishers(name)),
        ("Subscribes", topics.subscribers(name)),
    ):
        if verb == "Subscribes" and node.hears_all:
            parts.append("**Subscribes** to every topic that it finds.\n")
        else:
            rows = [_end(name, topic, end) for topic, end in ends.items()]
            head: tuple[str, ...] = ("topic", "type", "quality of service", "only")
            parts += [f"**{verb}**\n", _table(head, rows)]
    if node.serves:
        served = [(_code(one), _type(kind), does) for one, (kind, does) in node.serves.items()]
        parts += ["**Services**\n", _table(("service", "type", "does"), served)]
    if node.calls:
        parts.append(f"**Calls** {', '.join(map(_code, node.calls))}.\n")
    for title, parameters in _parameter_groups(name):
        head = ("parameter", "default", "must be", "live", "meaning")
        parts += [f"**Parameters{title}**\n", _table(head, map(_parameter, parameters))]
    return "\n".join(parts)


def _end(node: str, topic: Topic, end: End) -> tuple[str, ...]:
    only = [end.later] if end.later else []
    if end.given is not None:
        name, value = end.given
        assert name in NODE_TABLE[node].parameters(), f"{node} has no parameter {name}"
        only.append(f"with {_code(f'{name}: {_value(value)}')}")
    # Two subscriptions hear both kinds of publisher.
    qos = " or ".join(one.value for one in end.qos)
    return _code(topic.name), _type(topic.type), qos, "; ".join(only)


# --- parameters ---


def _parameter_groups(node: str) -> list[tuple[str, list[Parameter]]]:
    """Parameters of all, then those of one method or one law alone."""
    owners: dict[str, list[str]] = {}
    for law, kind in LAWS.items():
        for parameter in kind.PARAMETERS:
            owners.setdefault(parameter.name, []).append(_code(law))
    groups: dict[str, list[Parameter]] = {"": []}
    for parameter in NODE_TABLE[node].parameters():
        prefix, dot, _ = parameter.name.rpartition(".")
        methods = [_code(name) for name, kind in ESTIMATORS.items() if kind.group == prefix]
        title = f" of method {', '.join(methods)}" if dot else ""
        if node == "fvs_controller_node" and parameter.name in owners:
            title = f" of law {', '.join(owners[parameter.name])}"
        groups.setdefault(title, []).append(parameter)
    return list(groups.items())


def _parameter(parameter: Parameter) -> tuple[str, ...]:
    return (
        _code(parameter.name),
        _default(parameter.default),
        parameter.expected(),
        "live" if parameter.live else "",
        sentence(parameter.description),
    )


def sentence(text: str) -> str:
    """A description with a capital letter, a full stop, and ROS names set as code."""
    text = text.strip()
    first = text.split(maxsplit=1)[0] if text else ""
    if first.endswith(":"):  # what a value means
        text = f"`{first[:-1]}`{text[len(first) - 1 :]}"
    elif "_" not in first and (len(first) != 1 or first == "a"):  # names and symbols stay
        text = text[:1].upper() + text[1:]
    text = _NAME.sub(r"`\1`", text)
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _default(value: Any) -> str:
    if isinstance(value, list):
        # Three numbers or one text a line: a long default would widen the whole column.
        cells = [_value(one) for one in value]
        step = 1 if isinstance(value[0], str) else 3
        lines = [", ".join(cells[i : i + step]) for i in range(0, len(cells), step)]
        return "<br>".join(map(_code, lines))
    return _code(_value(value)) if value != "" else "empty"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        text = f"{value:.6g}"
        return text if re.search(r"[.e]", text) else f"{text}.0"
    return str(value)


# --- reasons ---


def _reasons_table() -> str:
    rows = [
        (
            _code(reason.name),
            _code(reason.state.value),
            _STOPS[reason.stop],
            "yes" if reason.needs_start else "",
            sentence(readable(reason.text)),
        )
        for reason in Reason
    ]
    return _table(("reason", "state", "the arm", "needs a new start", "says"), rows)


def readable(template: str) -> str:
    """A format string with its fields as words in italics, without their units."""
    parts = []
    for literal, field, _spec, _conversion in string.Formatter().parse(template):
        words = _UNIT.sub("", field).replace("_", " ") if field else ""
        parts.append(literal + (f"*{words}*" if words else ""))
    return "".join(parts)


# --- Markdown ---


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    cells = ([cell.replace("|", r"\|") for cell in row] for row in rows)
    return "".join(f"| {' | '.join(line)} |\n" for line in (head, ["---"] * len(head), *cells))


def _code(text: str) -> str:
    return f"`{text}`"


def _type(name: str) -> str:
    """``sensor_msgs/JointState``, as people write it."""
    return name.replace("/msg/", "/").replace("/srv/", "/")


def _link(node: str) -> str:
    short = node.removeprefix("fvs_").removesuffix("_node")
    return f"[{short}](#{node})"


# --- access rules ---


def policy(namespace: str = "") -> str:
    """The SROS2 policy of nodes in a namespace: who may publish, subscribe and serve what (XML)."""
    namespace = namespace.strip("/")
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    everything, services = set(topics.EVERY_NODE_PUBLISHES), set()
    for name, node in NODES.items():
        published = {topic.name for topic in topics.publishers(name)}
        heard = {topic.name for topic in topics.subscribers(name)}
        if node.hears_all:
            heard.add("/*")
        served = {*node.serves, *topics.EVERY_NODE_SERVES}
        _enclave(enclaves, name, namespace, published, heard, served, node.calls)
        everything |= {one.replace("~", name, 1) for one in published}
        services |= {one.replace("~", name, 1) for one in served}
    _enclave(enclaves, OPERATOR, namespace, {topics.TARGET_POSITION.name}, everything, (), services)
    ET.indent(root)
    where = f" in namespace /{namespace}" if namespace else ""
    holds = f"namespace /{namespace}" if namespace else "the root namespace"
    head = _POLICY_HEAD.format(where=where, holds=holds)
    return head + ET.tostring(root, encoding="unicode") + "\n"


def _enclave(
    enclaves: ET.Element,
    node: str,
    namespace: str,
    published: Iterable[str],
    heard: Iterable[str],
    served: Iterable[str],
    called: Iterable[str],
) -> None:
    """Add the rules of one node."""
    enclave = ET.SubElement(enclaves, "enclave", path=topics.resolve("~", node, namespace))
    profiles = ET.SubElement(enclave, "profiles")
    profile = ET.SubElement(profiles, "profile", ns=f"/{namespace}", node=node)
    declared, *others = topics.CAMERA_PREFIXES  # a camera is looked for under each
    cameras = [name.partition("/")[2] for name in heard if name.startswith(f"{declared}/")]
    heard = {*heard, *(f"{other}/{name}" for other in others for name in cameras)}
    for kind, verb, names in (
        ("topic", "publish", {*published, *topics.EVERY_NODE_PUBLISHES}),
        ("topic", "subscribe", {*heard, *topics.EVERY_NODE_SUBSCRIBES}),
        ("service", "reply", served),
        ("service", "request", called),
    ):
        if names:
            rules = ET.SubElement(profile, f"{kind}s", {verb: "ALLOW"})
            for name in sorted(names):
                ET.SubElement(rules, kind).text = name


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
