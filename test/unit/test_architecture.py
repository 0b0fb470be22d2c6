"""The direction of imports: node.py → its siblings → fvs_ros.core → numpy, never slice to slice."""

import ast
import sys
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = sorted(path.name for path in ROOT.glob("fvs_*") if (path / "__init__.py").is_file())
SOURCES = sorted(
    path.relative_to(ROOT).as_posix() for name in PACKAGES for path in (ROOT / name).rglob("*.py")
)

ROS_MODULE = "fvs_ros/core/ros.py"
TRAINING = "fvs_estimator_node/varpro.py"
SIMULATOR = "fvs_sim_node"
CORE_MAY_IMPORT = {"numpy", "yaml", "fvs_ros"}
CV2_IN_CORE = {"fvs_ros/core/detection.py", "fvs_ros/core/images.py"}


def imported_modules(path, source):
    """Absolute names of all that is imported, at the top or inside functions.

    ``from a import b`` yields both ``a`` and ``a.b``, as ``b`` may be a module.
    """
    package = PurePosixPath(path).parent.parts
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            names.add(module)
            names.update(f"{module}.{alias.name}" for alias in node.names)
    return names


def is_slice(package):
    return package.startswith("fvs_") and package.endswith("_node")


def is_ros(module):
    package = module.partition(".")[0]
    return package in {"rclpy", "std_srvs"} or package.endswith(("_msgs", "_interfaces"))


def violations(path, source):
    """Sentences about the imports of one file that break a rule."""
    file = PurePosixPath(path)
    home = file.parts[0]
    in_core = file.is_relative_to("fvs_ros/core")
    in_apps = file.is_relative_to("fvs_ros/apps")
    is_node = file.name.endswith("node.py")
    modules = imported_modules(path, source)
    packages = {module.partition(".")[0] for module in modules}
    found = []

    for package in sorted(packages):
        if is_ros(package) and not is_node and path != ROS_MODULE:
            found.append(f"{path} imports {package}: only *node.py and {ROS_MODULE} know ROS")
        if package == "pybullet" and home != SIMULATOR:
            found.append(f"{path} imports pybullet: only {SIMULATOR} may")
        if package == "torch" and path != TRAINING:
            found.append(f"{path} imports torch: only {TRAINING} may")
        if is_slice(package) and package != home and not in_apps:
            found.append(f"{path} imports {package}: only fvs_ros/apps composes slices")
        if in_core and not (
            package in CORE_MAY_IMPORT
            or package in sys.stdlib_module_names
            or (package == "cv2" and path in CV2_IN_CORE)
            or (is_ros(package) and path == ROS_MODULE)
        ):
            found.append(f"{path} imports {package}: fvs_ros/core stays on numpy, yaml and stdlib")
    if "fvs_ros.core.ros" in modules and not is_node:
        found.append(f"{path} imports fvs_ros.core.ros and so rclpy: only *node.py may")
    if "fvs_ros.apps" in modules and not in_apps:
        found.append(f"{path} imports fvs_ros.apps: it is on top of all")
    return found


def test_the_sources_are_found():
    slices = {f"fvs_{name}_node" for name in ("sim", "detector", "estimator", "controller")}
    assert {"fvs_ros", *slices} <= set(PACKAGES)
    assert ROS_MODULE in SOURCES


@pytest.mark.parametrize("path", SOURCES)
def test_imports_point_one_way(path):
    assert violations(path, (ROOT / path).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("fvs_controller_node/ftsm.py", "import rclpy"),
        ("fvs_controller_node/ftsm.py", "from std_msgs.msg import Float64MultiArray"),
        ("fvs_controller_node/ftsm.py", "def f():\n    from std_srvs.srv import Trigger"),
        ("fvs_controller_node/inputs.py", "from builtin_interfaces.msg import Time"),
        ("fvs_controller_node/inputs.py", "from fvs_ros.core import ros"),
        ("fvs_controller_node/inputs.py", "from fvs_ros.core.ros import to_stamp"),
        ("fvs_controller_node/node.py", "from fvs_estimator_node.rbf import RbfModel"),
        ("fvs_controller_node/node.py", "import fvs_sim_node.kinematics as kinematics"),
        ("fvs_controller_node/node.py", "from fvs_ros.apps import launcher"),
        ("fvs_estimator_node/rbf.py", "class A:\n    def f(self):\n        import torch.nn"),
        ("fvs_estimator_node/node.py", "if True:\n    import pybullet"),
        ("fvs_ros/core/limits.py", "from fvs_controller_node import limits"),
        ("fvs_ros/core/limits.py", "from ..apps import launcher"),
        ("fvs_ros/core/limits.py", "import scipy.optimize"),
        ("fvs_ros/core/camera.py", "import cv2"),
        ("fvs_ros/core/ros.py", "def f():\n    import cv2"),
        ("fvs_detector_node/annotate.py", "from fvs_sim_node.rendering import Renderer"),
        ("fvs_detector_node/detector.py", "from sensor_msgs.msg import Image"),
        ("fvs_ros/core/camera.py", "from . import ros"),
        ("fvs_ros/apps/launcher.py", "import rclpy"),
        ("fvs_ros/apps/launcher.py", "from fvs_ros.core import ros"),
        ("fvs_ros/apps/train.py", "import torch"),
        ("fvs_ros/apps/demo_node.py", "import pybullet"),
    ],
)
def test_a_forbidden_import_is_found(path, source):
    assert violations(path, source) != []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("fvs_controller_node/node.py", "import rclpy\nfrom fvs_ros.core import ros"),
        ("fvs_controller_node/node.py", "from fvs_controller_node.ftsm import FtsmLaw"),
        ("fvs_controller_node/node.py", "from . import ftsm"),
        ("fvs_estimator_node/collector_node.py", "from sensor_msgs.msg import JointState"),
        ("fvs_estimator_node/varpro.py", "import torch"),
        ("fvs_sim_node/world.py", "import pybullet"),
        ("fvs_ros/core/detection.py", "import cv2\nimport numpy as np"),
        ("fvs_ros/core/images.py", "import cv2\nimport struct"),
        ("fvs_detector_node/rectifier.py", "import cv2"),
        ("fvs_ros/core/ros.py", "import rclpy\nfrom std_msgs.msg import Float64MultiArray"),
        ("fvs_ros/core/params.py", "import yaml\nfrom fvs_ros.core.joints import JointMap"),
        ("fvs_ros/apps/train.py", "from fvs_estimator_node import training, rbf\nimport tqdm"),
        ("fvs_ros/apps/demo_node.py", "import rclpy\nimport fvs_sim_node.config"),
    ],
)
def test_an_allowed_import_is_passed(path, source):
    assert violations(path, source) == []


NODES = [path for path in SOURCES if path.endswith("node.py")]
KEEPS = "keeps_subscriptions = True"


@pytest.mark.parametrize("path", [p for p in NODES if KEEPS in (ROOT / p).read_text("utf-8")])
def test_a_node_that_keeps_its_subscriptions_destroys_none(path):
    assert "destroy_" not in (ROOT / path).read_text(encoding="utf-8")


def test_the_nodes_of_the_loop_keep_their_subscriptions():
    for name in ("sim", "estimator", "controller"):
        assert KEEPS in (ROOT / f"fvs_{name}_node/node.py").read_text(encoding="utf-8")
