"""A node that waits for its inputs without end: ``python -m patient_node MODULE arguments``."""

import math
import runpy
import sys

from fvs_ros import stop

stop.listen()

from fvs_estimator_node import collecting
from fvs_tools import demo

collecting.GIVE_UP_S = demo.START_TIMEOUT_S = math.inf
del sys.argv[0]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
