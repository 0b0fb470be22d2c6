"""What describes the package agrees: setup.py, package.xml, CITATION.cff and the tree."""

import re
import runpy
import xml.etree.ElementTree as ET
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def setup_arguments():
    """What setup.py hands to setuptools."""
    with pytest.MonkeyPatch.context() as patch:
        handed = {}
        patch.chdir(ROOT)
        patch.setattr("setuptools.setup", handed.update)
        runpy.run_path("setup.py")
    return handed


def test_all_places_name_the_same_version(setup_arguments):
    first = {
        "package.xml": r"<version>(.+)</version>",
        "CITATION.cff": r"(?m)^version: (.+)$",
        "CHANGELOG.rst": r"(?m)^(\d+\.\d+\.\d+) \(",
        "README.md": r"version = {(.+)}",
    }
    texts = {name: (ROOT / name).read_text("utf-8") for name in first}
    versions = {name: re.search(pattern, texts[name])[1] for name, pattern in first.items()}
    assert versions == dict.fromkeys(first, setup_arguments["version"])


def test_links_of_the_readme_hold_on_a_package_index(setup_arguments):
    links = re.findall(r"\]\(([^)]+)\)", setup_arguments["long_description"])
    assert len(links) > 10
    assert [link for link in links if not link.startswith(("https://", "#"))] == []


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
    extras, always = setup_arguments["extras_require"], setup_arguments["install_requires"]
    requirements = [*always, *chain.from_iterable(extras.values())]
    assert [line for line in requirements if not re.search(">=.*<", line)] == []
    assert not [line for line in (*always, *extras["sim"]) if line.startswith("torch")]
    assert {*extras["ros"], *extras["camera"]} <= {*extras["sim"]}
