"""The snippets of README.md do what they say."""

import re
from pathlib import Path

import pytest
from cases import each

import fvs_ros

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@each("snippet", SNIPPETS)
def test_a_snippet_brings_the_ball_to_its_target(snippet, capsys):
    exec(compile(snippet, "snippet", "exec"), {})
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert float(re.fullmatch(r"on target, ([\d.]+) mm off", last)[1]) < 1.0


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
