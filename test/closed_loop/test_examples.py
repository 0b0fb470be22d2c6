"""The examples do what they say, and what their pages promise of another package holds."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest
from cases import each

from fvs_controller_node.config import LAWS
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros.paths import registered

FOLDER = Path(__file__).resolve().parents[2] / "examples"
#: What each prints at the end, and the largest of the numbers in it.
PRINTED = {
    "01_servo_a_ball": (r"true error: ([\d.]+) mm", 1.0),
    "02_your_own_detector": (r"moved by \[ *([\d.]+) +([\d.]+) +-?[\d.]+\] mm", 105.0),
    "03_your_own_robot": (r"off\nJacobian.*\n.* ([\d.]+) s old", 0.6),
    "04_your_own_law": (r"mine\+mine .* ([\d.]+) s\npoe\+mine .* ([\d.]+) s\n", 2.0),
    "05_teach_and_repeat": (r"(?s)true: ([\d.]+) mm.*true: ([\d.]+) mm", 0.5),
    "06_camera_on_the_arm": (r"true error: ([\d.]+) mm and ([\d.]+) degrees", 0.5),
    "07_two_webcams": (r"on target, ([\d.]+) px off", 0.5),
    "08_calibrate": (r"true error .* ([\d.]+) mm", 2.0),
    "09_lerobot": (r"on target, ([\d.]+) mm off\nlast action sent: .*shoulder_pan", 0.5),
}


@each("name", [path.stem for path in sorted(FOLDER.glob("*.py"))])
def test_an_example_prints_what_it_says(name, capsys):
    words, most = PRINTED[name]
    with mock.patch.dict(LAWS), mock.patch.dict(ESTIMATORS):
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    printed = capsys.readouterr().out
    match = re.search(words, printed)
    assert match, printed
    assert max(map(float, match.groups())) < most


def test_a_wrapped_robot_has_lerobots_interface(capsys):
    robot = runpy.run_path(str(FOLDER / "09_lerobot.py"))["robot"]
    verbs = ("connect", "disconnect", "calibrate", "configure", "get_observation", "send_action")
    assert all(callable(getattr(robot, verb)) for verb in verbs)
    assert robot.is_connected is False
    assert robot.action_features.keys() < robot.observation_features.keys()
    assert robot.get_observation().keys() == robot.observation_features.keys()
    with pytest.raises(ValueError, match="target refused"):
        robot.send_action(dict.fromkeys(robot.action_features, 9.0))


def install(folder, entry_points):
    """Another package."""
    package = folder / "my_package-1.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1\n")
    (package / "entry_points.txt").write_text(entry_points)


def test_another_packages_law_may_not_have_the_name_of_an_own_one(tmp_path, monkeypatch):
    install(tmp_path, "[fvs_ros.laws]\nftsm = mine:MyLaw\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.warns(match="ftsm = mine:MyLaw is left out: .*another has this name"):
        assert registered("laws", LAWS) == LAWS


def test_another_packages_law_and_estimator_have_names_everywhere(tmp_path):
    install(
        tmp_path,
        "[fvs_ros.laws]\nmine = 04_your_own_law:MyLaw\n"
        "[fvs_ros.estimators]\nmine = 04_your_own_law:MyEstimator\n",
    )
    program = (
        "from fvs_tools.scenario import load_scenario\n"
        "from fvs_lab.robustness import schemes_called\n"
        "scenario = load_scenario('servo', ['my_gain_1_s:=4'], 'mine+mine')\n"
        "own = scenario['fvs_controller_node']\n"
        "print(scenario['fvs_estimator_node']['method'], own['law'], own['my_gain_1_s'])\n"
        "print(schemes_called(['mine+mine'])[0].law)\n"
    )
    paths = f"{tmp_path}{os.pathsep}{FOLDER}"
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": paths},
        cwd=FOLDER.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stdout == "mine mine 4.0\nmine\n", result.stderr
