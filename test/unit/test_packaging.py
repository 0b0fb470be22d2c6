"""package.xml, setup.py, constraints.txt, CHANGELOG.rst and the tree say the same."""

import re
import runpy
import xml.etree.ElementTree as ET
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_NAME = re.compile(r"^[A-Za-z0-9._-]+")


@pytest.fixture(scope="module")
def setup_arguments():
    """What setup.py hands to setuptools."""
    with pytest.MonkeyPatch.context() as patch:
        handed = {}
        patch.chdir(ROOT)
        patch.setattr("setuptools.setup", handed.update)
        runpy.run_path("setup.py")
    return handed


def requirement_name(line):
    return _NAME.match(line).group().lower().replace("_", "-")


def test_manifest_names_every_ros_package_that_is_imported():
    manifest = ET.parse(ROOT / "package.xml").getroot()
    declared = {element.text for element in manifest if element.tag.endswith("depend")}
    pattern = re.compile(
        r"^\s*(?:from|import) (rclpy|launch|launch_ros|std_srvs|\w+_msgs|\w+_interfaces)\b", re.M
    )
    files = [*ROOT.glob("fvs_*/**/*.py"), *ROOT.glob("launch/*.py")]
    assert {name for path in files for name in pattern.findall(path.read_text("utf-8"))} <= declared


def test_every_folder_and_shared_file_is_installed_where_it_lies(setup_arguments):
    folders = {path.parent for path in ROOT.glob("fvs_*/**/*.py")}
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    assert packages == set(setup_arguments["packages"])
    assert setup_arguments["package_data"]["fvs_dashboard"] == ["*.css"]
    files = dict(setup_arguments["data_files"])
    installed = {f"{target}/{Path(file).name}" for target, group in files.items() for file in group}
    for pattern in ("config/**/*.yaml", "config/**/*.npz", "config/**/*.urdf", "launch/**/*.py"):
        paths = ROOT.glob(pattern)
        assert {f"share/fvs_ros/{path.relative_to(ROOT).as_posix()}" for path in paths} <= installed
    assert files["share/ament_index/resource_index/packages"] == ["resource/fvs_ros"]


def test_requirements_are_bounded_on_both_sides_and_the_demo_needs_no_torch(setup_arguments):
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    bounds = {requirement_name(line): line for line in lines if line and line[0] != "#"}
    extras = setup_arguments["extras_require"]
    requirements = [*setup_arguments["install_requires"], *chain.from_iterable(extras.values())]
    wanted = {requirement_name(requirement) for requirement in requirements}
    assert wanted <= bounds.keys()
    assert [line for line in map(bounds.get, wanted) if not re.search(">=.*<", line)] == []
    demo = [*setup_arguments["install_requires"], *extras["ros"], *extras["sim"]]
    assert "torch" not in map(requirement_name, demo)
