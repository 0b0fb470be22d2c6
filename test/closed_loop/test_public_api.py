"""The example of docs/python.md does what it says."""

import re
from pathlib import Path

import pytest

import fvs_ros

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"


def test_the_example_of_the_page_brings_the_ball_to_its_target(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(example, str(PAGE), "exec"), {})
    first, last = capsys.readouterr().out.strip().splitlines()[-2:]
    assert first.startswith("SERVOING")
    assert float(last) < 1e-3


def test_the_face_offers_what_it_names():
    assert all(getattr(fvs_ros, name).__name__ == name for name in fvs_ros.__all__)
    with pytest.raises(AttributeError, match="nothing"):
        fvs_ros.nothing  # noqa: B018


def test_a_model_of_another_arm_is_refused():
    with (
        fvs_ros.Simulation(fvs_ros.SimConfig(robot="iiwa", rendered=False)) as simulation,
        pytest.raises(ValueError, match=r"joint order .*shoulder_pan_joint.* expected"),
    ):
        fvs_ros.ClosedLoop.of_scheme("best", simulation)
