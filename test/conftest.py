"""What every test needs before anything of ROS is imported."""

import atexit
import contextlib
import importlib.util
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import pytest

_LOG_DIR = tempfile.mkdtemp(prefix="fvs_test_log_")
atexit.register(shutil.rmtree, _LOG_DIR, ignore_errors=True)

# Without the check, a wrong type in a message's scalar field arrives as garbage, unnoticed.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# Two workers whose threads wait for each other by spinning take ten times as long to train.
os.environ.update({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
os.environ["ROS_LOG_DIR"] = _LOG_DIR
os.environ.setdefault(
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    str(Path(__file__).resolve().parents[1] / "config" / "quick_discovery.xml"),
)

# The source tree comes first, installed or not: here and in the processes that tests start.
_ROOT = str(Path(__file__).resolve().parents[1])
if _ROOT not in sys.path:
    sys.path.insert(0, _ROOT)
_PATHS = (_ROOT, str(Path(__file__).parent), os.environ.get("PYTHONPATH"))
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, _PATHS))


def _slowness():
    """How many times as long the work of a good computer takes here and now; 1 at least."""
    began_s, done = time.monotonic(), 0
    while (passed_s := time.monotonic() - began_s) < 1.0:  # whoever is new gets more at first
        for _ in range(100_000):
            pass
        done += 1
    return min(max(1.0, passed_s / (0.004 * done)), 6.0)


if "PYTEST_XDIST_WORKER" not in os.environ:
    # Workers, and what they start, inherit the speed.
    slowness = _slowness()
    os.environ["FVS_TEST_SLOWNESS"] = f"{slowness:.2f}"
    # Longer than any test waits by itself: it ends what hangs.
    os.environ.setdefault("PYTEST_TIMEOUT", f"{180 * slowness:.0f}")


def _harness(folder, **options):
    from harness import Harness  # brings rclpy, which unit tests do without

    with contextlib.closing(Harness(folder, **options)) as harness:
        yield harness


@pytest.fixture
def ros_test(tmp_path):
    """A ROS context of its own and the node processes of one test."""
    yield from _harness(tmp_path)


@pytest.fixture(scope="module")
def ros_module(tmp_path_factory):
    """Node processes that the tests of a module share, until one of them fails."""
    yield from _harness(tmp_path_factory.mktemp("shared"))


@pytest.fixture
def ros_beside(ros_module, tmp_path):
    """A ROS context of its own beside the shared processes."""
    yield from _harness(tmp_path, beside=ros_module)


def pytest_runtest_makereport(item, call):
    if call.excinfo is not None and "ros_module" in getattr(item, "funcargs", {}):
        item.funcargs["ros_module"].end_processes()


def pytest_configure(config):
    config.addinivalue_line(
        "markers", "torch: trains with torch; skipped where it is not installed"
    )
    # xdist would replace a worker that died, and then wait for it for ever.
    if getattr(config.option, "maxworkerrestart", "0") is None:
        config.option.maxworkerrestart = "0"
    if importlib.util.find_spec("hypothesis") is not None:
        from hypothesis import settings

        # How long an example takes says more of the machine than of the code.
        settings.register_profile("untimed", deadline=None)
        settings.load_profile("untimed")


#: Folders of tests with processes over DDS in real time.
_REAL_TIME = ("nodes", "faults")


def _is_real_time(item):
    return item.path.parent.name in _REAL_TIME


def pytest_collection_modifyitems(config, items):
    real_time = [item for item in items if _is_real_time(item)]
    if config.pluginmanager.hasplugin("rerunfailures"):
        # A machine that stands still for a moment is no fault of ours; one that does so twice is.
        for item in real_time:
            item.add_marker(pytest.mark.flaky(reruns=1, rerun_except="Failed: Timeout"))
    # They take longest, so that they begin first.
    items[:] = real_time + [item for item in items if not _is_real_time(item)]
    if importlib.util.find_spec("torch") is None:
        for item in items:
            if item.get_closest_marker("torch"):
                item.add_marker(pytest.mark.skip(reason="torch is not installed"))


def pytest_terminal_summary(terminalreporter):
    # What passes the second time may have told the truth the first time.
    for report in terminalreporter.stats.get("rerun", ()):
        terminalreporter.section(f"failed once: {report.nodeid}")
        terminalreporter.write_line(report.longreprtext)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        """The real-time tests of a file share processes; all others go where there is time."""

        def _split_scope(self, nodeid):
            path = Path(nodeid.partition("::")[0])
            return str(path) if path.parent.name in _REAL_TIME else nodeid

    return ByFile(config, log)
