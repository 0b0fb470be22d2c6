"""``python -m fvs_tools.reference``: writes the page that follows from the declarations.

``docs/reference.md`` is made from the topics, services, parameters, reasons and exit codes that the
code declares. It is committed; a test compares it with what would be written now.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fvs_controller_node.config import LAWS, SupervisorConfig
from fvs_controller_node.reasons import Reason
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import stop, topics
from fvs_ros.kinds import KINDS
from fvs_ros.params import Parameter
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_tools.scenario import NODE_TABLE

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference.md"
COMMAND = "python -m fvs_tools.reference"

#: A field of a reason's text, and its name without the unit.
_FIELD = re.compile(r"\{(\w+?)(?:_(?:mm|m|s|rad|m_s|rad_s|deg|hz|percent))?(?::[^}]*)?\}")
#: A topic, service or parameter within a sentence.
_NAME = re.compile(r"(?<![\w`/~^.*)])(~?/[a-z]\w*(?:/\w+)*|[a-z]\w*_\w+)(?![\w`/*(])")


def page() -> str:
    """The whole of ``docs/reference.md``."""
    functions = (sentence, readable, plain_type, default_text, allowed, links)
    named = {each.__name__: each for each in (*functions, shared_parameters, parameter_groups)}
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters.update(named)
    by_feature = {"": topics.COMMON, **{name: kind.topics for name, kind in KINDS.items()}}
    return environment.get_template("reference.md.jinja").render(
        **named,
        NODES=topics.NODES,
        SERVICES=topics.SERVICES,
        TOPICS=by_feature,
        Reason=Reason,
        stop=stop,
    )


# --- topics ---


def plain_type(name: str) -> str:
    """``sensor_msgs/JointState``, as people write it."""
    return name.replace("/msg/", "/").replace("/srv/", "/")


def links(nodes: Iterable[str], other: str = "") -> str:
    """Nodes, and who else, with links to their parameters."""
    names = {node: node.removeprefix("fvs_").removesuffix("_node") for node in nodes}
    if len(names) == len(topics.NODES):
        return "every node"
    words = [f"[{name}](#{node})" for node, name in names.items()]
    return ", ".join([*words, other] if other else words)


# --- parameters ---


def _by_meaning() -> list[dict[str, Parameter]]:
    """Each parameter, by the nodes that have it alike, live or not."""
    found: dict[str, dict[str, Parameter]] = {}
    for node, entry in NODE_TABLE.items():
        for one in entry.parameters():
            found.setdefault(repr(replace(one, live=False)), {})[node] = one
    return list(found.values())


def shared_parameters() -> list[tuple[Parameter, list[str], bool]]:
    """Parameters of several nodes: one, its nodes, and whether it is live in one of them."""
    return [
        (next(iter(nodes.values())), list(nodes), any(each.live for each in nodes.values()))
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


def allowed(parameter: Parameter, live: bool) -> str:
    """Values of a parameter, without words for what its default shows, and whether it is live."""
    text = parameter.expected()
    if parameter.kind in (bool, str) and not (parameter.choices or parameter.is_list):
        text = ""
    words = text.removeprefix("number from ").removeprefix("one of ")
    return "; ".join(filter(None, (words, "live" * live)))


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


# --- program ---


def main() -> int:
    """Write the page."""
    argparse.ArgumentParser(prog=COMMAND, description=__doc__).parse_args()
    if not PAGE.parent.is_dir():
        print("the page is written in the source tree only", file=sys.stderr)
        return EXIT_BAD_INPUT
    PAGE.write_text(page(), encoding="utf-8")
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
