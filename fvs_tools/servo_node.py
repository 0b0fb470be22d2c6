"""``fvs_servo_node``: estimator and controller of one arm, or of several, in one process.

Name a namespace for each of several arms; without one it is a single arm.
"""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections.abc import Sequence

from rclpy.utilities import remove_ros_args

from fvs_controller_node.config import PARAMETERS as CONTROLLER
from fvs_controller_node.node import ControllerNode
from fvs_estimator_node.node import EstimatorNode
from fvs_estimator_node.registry import PARAMETERS as ESTIMATOR
from fvs_ros import ros

#: Each once: what both have is the same.
PARAMETERS = tuple({one.name: one for one in (*CONTROLLER, *ESTIMATOR)}.values())


def make_nodes(namespaces: Sequence[str]) -> list[ros.FvsNode]:
    """Both nodes of each arm; a ``ValueError`` if two arms share a namespace."""
    nodes: list[ros.FvsNode] = []
    for namespace in namespaces or [""]:
        # The controller first: its command does not wait for the estimator.
        nodes.append(ControllerNode(namespace=namespace, others=ESTIMATOR))
        nodes.append(EstimatorNode(namespace=namespace, others=CONTROLLER))
    names = [node.get_fully_qualified_name() for node in nodes]
    if len(set(names)) < len(names):
        raise ValueError(
            f"each arm needs a namespace of its own, got {', '.join(sorted(set(names)))} twice"
        )
    return nodes


def main() -> int:
    """Run ``fvs_servo_node``."""
    words = [word for word in remove_ros_args(sys.argv)[1:] if not word.startswith("-")]
    return ros.run(lambda: make_nodes(words), __doc__, PARAMETERS, words)


if __name__ == "__main__":
    sys.exit(main())
