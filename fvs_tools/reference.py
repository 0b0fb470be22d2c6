"""``python -m fvs_tools.reference``: writes the pages that follow from the code.

``docs/reference.md`` is made from the topics, services, parameters, reasons and exit codes that the
code declares, ``docs/examples.md`` from ``examples/``. They are committed; a test compares them
with what would be written now.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fvs_controller_node.config import LAWS, SupervisorConfig
from fvs_controller_node.reasons import Reason, State, Stop
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import stop, topics
from fvs_ros.kinds import KINDS
from fvs_ros.params import Parameter
from fvs_ros.stop import EXIT_OK
from fvs_tools.scenario import parameters_of

_ROOT = Path(__file__).resolve().parents[1]
COMMAND = "python -m fvs_tools.reference"


def pages() -> dict[Path, str]:
    """The generated pages by their files."""
    docs = _ROOT / "docs"
    return {docs / "reference.md": page(), docs / "examples.md": examples()}


def examples() -> str:
    """The whole of ``docs/examples.md``: question, answer and code of each."""
    words = [
        "# Examples",
        "Each answers one question and runs in a clone without display, in some seconds:",
        "```sh\npython examples/01_servo_a_ball.py\n```",
    ]
    for path in sorted(_ROOT.glob("examples/*.py")):
        _, text, code = path.read_text(encoding="utf-8").split('"""', 2)
        title, _, answer = text.partition("\n")
        words += [f"## {title}", f"[{path.name}](../examples/{path.name})", answer.strip()]
        words.append(f"```python\n{code.strip()}\n```")
    return "\n\n".join(words) + "\n"


def page() -> str:
    """The whole of ``docs/reference.md``."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    functions = plain_type, links, value, sentence
    environment.filters.update({each.__name__: each for each in functions})
    alike = _alike()
    return environment.get_template("reference.md.jinja").render(
        NODES=list(topics.NODES),
        SERVICES=topics.SERVICES,
        TOPICS={"": topics.COMMON, **{name: kind.topics for name, kind in KINDS.items()}},
        SHARED=[nodes for nodes in alike if len(nodes) > 1],
        OWN={
            node: [nodes[node] for nodes in alike if list(nodes) == [node]] for node in topics.NODES
        },
        OWNERS=_owners(),
        REASONS=_reasons(),
        STOPS={"NONE": "continues", "RAMP": "ramps to rest", "AT_ONCE": "zeros at once"},
        stop=stop,
    )


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


def _alike() -> list[dict[str, Parameter]]:
    """Each parameter, by the nodes that have it alike, live or not."""
    alike: dict[str, dict[str, Parameter]] = {}
    for node in topics.NODES:
        for parameter in parameters_of(node):
            alike.setdefault(repr(replace(parameter, live=False)), {})[node] = parameter
    return list(alike.values())


def _owners() -> dict[str, list[str]]:
    """The laws or methods that alone have a parameter, by its name."""
    owners = defaultdict(list)
    common = {parameter.name for parameter in SupervisorConfig.declared()}
    for law, kind in LAWS.items():
        for parameter in kind.Gains.declared():
            if parameter.name not in common:
                owners[parameter.name].append(law)
    for parameter in parameters_of(topics.ESTIMATOR):
        prefix, dot, _ = parameter.name.partition(".")
        methods = [name for name, kind in ESTIMATORS.items() if dot and kind.group == prefix]
        owners[parameter.name] += methods
    return owners


def _reasons() -> dict[tuple[State, Stop, bool], list[str]]:
    """The reasons of each state, stop, and need of a new start."""
    groups = defaultdict(list)
    for reason in Reason:
        groups[reason.state, reason.stop, reason.needs_start].append(f"`{reason.name}`")
    return groups


def value(parameter: Parameter, live: bool) -> str:
    """Default and range of a parameter, and whether it is live."""
    default, low, high = parameter.default, parameter.minimum, parameter.maximum
    words = default if isinstance(default, str) else json.dumps(default)
    parts = [
        f"`{words}`" if words else "empty",
        ", ".join(other for other in parameter.choices or () if other != default),
    ]
    if low is not None:
        parts.append(f"at least {low:g}" if high is None else f"{low:g} to {high:g}")
    return "; ".join(filter(None, [*parts, "live" * live]))


def sentence(text: str) -> str:
    """A description with a capital letter and a full stop."""
    if text.partition(" ")[0].strip(":,;").isalpha():  # names and symbols stay
        text = text[:1].upper() + text[1:]
    text = text.replace("|", r"\|")
    return text if text.endswith((".", "!", "?")) else f"{text}."


def main() -> int:
    """Write the pages."""
    argparse.ArgumentParser(prog=COMMAND, description=__doc__).parse_args()
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
