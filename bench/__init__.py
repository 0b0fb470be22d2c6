"""Measurements that print tables; ``python -m bench NAME`` runs one."""

import os
import sys
from pathlib import Path

#: The checkout. Processes that are started see it, and the tests' helpers.
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]
os.environ["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "test")))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
