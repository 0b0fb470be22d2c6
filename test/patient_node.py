"""Nodes of one kind that wait for their inputs without end, in one process.

``python -m patient_node MODULE ARGUMENTS``: a JSON list with the arguments of each node.
"""

import json
import math
import sys
from functools import partialmethod
from importlib import import_module
from unittest import mock

from fvs_ros import stop

stop.listen()

from rclpy.node import Node

from fvs_estimator_node import collecting
from fvs_ros import ros
from fvs_tools import demo

collecting.GIVE_UP_S = demo.START_TIMEOUT_S = math.inf
_run = ros.run


def run(make, *rest):
    """As ``ros.run``, for a node of each of the given arguments."""

    def make_all():
        for arguments in groups:
            init = partialmethod(Node.__init__, cli_args=arguments)
            with mock.patch.object(Node, "__init__", init):
                made.append(make())
        return made

    made = []
    return _run(make_all, *rest)


module, groups = sys.argv[1], json.loads(sys.argv[2])
del sys.argv[1:]
ros.run = run
sys.exit(import_module(module).main())
