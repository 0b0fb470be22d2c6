"""``fvs_servo_node``: estimator and controller of one arm, or of several, in one process.

Name a namespace for each of several arms; a single arm needs none.
"""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections.abc import Sequence

from fvs_controller_node.config import PARAMETERS as CONTROLLER
from fvs_controller_node.node import ControllerNode
from fvs_estimator_node.node import EstimatorNode
from fvs_estimator_node.registry import PARAMETERS as ESTIMATOR
from fvs_ros import ros

#: Each once: what both have is the same.
PARAMETERS = tuple({each.name: each for each in (*CONTROLLER, *ESTIMATOR)}.values())


def make_nodes(namespaces: Sequence[str]) -> list[ros.FvsNode]:
    """Both nodes of each arm; a ``ValueError`` if two arms share a namespace."""
    nodes: list[ros.FvsNode] = []
    for namespace in namespaces or [""]:
        # The controller first: its command does not wait for the estimator.
        nodes += [ControllerNode(namespace), EstimatorNode(namespace)]
    names = [node.get_fully_qualified_name() for node in nodes]
    twice = ", ".join(dict.fromkeys(name for name in names if names.count(name) > 1))
    if twice:
        raise ValueError(
            f"several nodes are called {twice}: each arm needs a namespace of its own, and neither "
            "__ns nor __node may be remapped"
        )
    return nodes


def main() -> int:
    """Run ``fvs_servo_node``."""
    return ros.run(make_nodes, __doc__, PARAMETERS, takes="[NAMESPACE ...]")


if __name__ == "__main__":
    sys.exit(main())
