"""Three floors, arrows only down: ``fvs_ros``, the nodes, what composes them; no kind is asked."""

import ast
import sys
from graphlib import TopologicalSorter
from pathlib import Path, PurePosixPath

from cases import each

from fvs_ros.kinds import KINDS

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = sorted(path.name for path in ROOT.glob("fvs_*") if (path / "__init__.py").is_file())
SOURCES = sorted(
    path.relative_to(ROOT).as_posix() for name in PACKAGES for path in (ROOT / name).rglob("*.py")
)

#: Each package may import those before it, none beside it.
ORDER = (
    {"fvs_ros"},
    {"fvs_detector_node"},
    {"fvs_controller_node", "fvs_estimator_node", "fvs_sim_node"},  # whose positions are detected
    {"fvs_tools", "fvs_dashboard"},
    {"fvs_lab"},
)
ROS_HOME = "fvs_ros/ros"
IMAGES = "fvs_ros/ros/images.py"
BAGS = "fvs_tools/recorded.py"  # decodes messages that come from a file
TRAINING = "fvs_estimator_node/varpro.py"
SIMULATOR = "fvs_sim_node"
GROUND_MAY_IMPORT = {"numpy", "scipy", "yaml", "fvs_ros"}


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


def rank_of(package):
    return next((number for number, packages in enumerate(ORDER) if package in packages), None)


def is_ros(module):
    package = module.partition(".")[0]
    return package in {"rclpy", "std_srvs"} or package.endswith(("_msgs", "_interfaces"))


def foreign(path, modules):
    """Packages that a file imports and may not, by CONTRIBUTING.md."""
    file, home = PurePosixPath(path), path.partition("/")[0]
    in_ros = file.is_relative_to(ROS_HOME)
    may_ros = in_ros or file.name.endswith("node.py") or path == BAGS

    def allowed(package):
        if is_ros(package):
            return in_ros or (may_ros and home != "fvs_ros")
        if package in ("pybullet", "torch"):
            return home == SIMULATOR if package == "pybullet" else path == TRAINING
        if home == "fvs_ros":
            known = package in GROUND_MAY_IMPORT or package in sys.stdlib_module_names
            return known or (package == "cv2" and path == IMAGES)
        rank = rank_of(package)
        return package == home or rank is None or rank < rank_of(home)

    packages = {module.partition(".")[0] for module in modules}
    broken = {package for package in packages if not allowed(package)}
    images = IMAGES.removesuffix(".py").replace("/", ".")  # brings cv2, not for every node
    if path == f"{ROS_HOME}/__init__.py":
        broken |= {images} & modules
    return broken if may_ros else broken | {"fvs_ros.ros"} & modules


@each("path", SOURCES)
def test_imports_point_one_way(path):
    modules = imported_modules(path, (ROOT / path).read_text(encoding="utf-8"))
    assert foreign(path, modules) == set()


def test_no_files_import_each_other_in_a_circle():
    files = {path.removesuffix(".py").replace("/", "."): path for path in SOURCES}
    imports = {
        name: imported_modules(path, (ROOT / path).read_text(encoding="utf-8")) & set(files)
        for name, path in files.items()
    }
    TopologicalSorter(imports).prepare()  # raises CycleError with the circle


def test_the_nodes_of_the_loop_keep_their_subscriptions():
    """Their executor does not support destroying subscriptions."""
    keep = "keeps_subscriptions = True"
    texts = {path: (ROOT / path).read_text("utf-8") for path in SOURCES if "node.py" in path}
    keeping = {path for path, text in texts.items() if keep in text}
    assert {f"fvs_{name}_node/node.py" for name in ("sim", "estimator", "controller")} <= keeping
    assert not [path for path in keeping if "destroy_" in texts[path]]


# ---- kinds of features -------------------------------------------------------------------------

KIND_CLASSES = {"Ball", "Pose", "PointStamped", "PoseStamped", "TagPose"}


def name_of(node):
    return getattr(node, "attr", getattr(node, "id", ""))


def asks_for_a_kind(node):
    """Whether an expression asks by class or by name."""
    if isinstance(node, ast.Call) and name_of(node.func) in {"isinstance", "issubclass"}:
        return any(name_of(part) in KIND_CLASSES for part in ast.walk(node.args[1]))
    if isinstance(node, (ast.Tuple, ast.List, ast.Set)):  # a list of kinds; a registry is a dict
        return bool(KINDS.keys() & {getattr(part, "value", None) for part in node.elts})
    if isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        words = {getattr(side, "value", None) for side in sides if isinstance(side, ast.Constant)}
        return bool(words & KINDS.keys() or KIND_CLASSES & set(map(name_of, sides)))
    return False


def asks(code):
    return any(map(asks_for_a_kind, ast.walk(ast.parse(code))))


def test_no_code_outside_a_kind_asks_which_kind_it_is():
    for code in ("isinstance(a, (int, Pose))", "b == 'pose'", "type(c) is Ball", "('pose',)"):
        assert asks(code)
    elsewhere = [path for path in SOURCES if not path.startswith("fvs_ros/kinds/")]
    assert [path for path in elsewhere if asks((ROOT / path).read_text("utf-8"))] == []
