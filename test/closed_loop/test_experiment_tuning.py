"""The tuning experiment: its knobs are real parameters, and its report is complete."""

import json

import pytest

from fvs_controller_node.config import default_values
from fvs_estimator_node.config import PARAMETERS
from fvs_lab import tuning
from fvs_lab.context import Context
from fvs_lab.report import Origin, write_report
from fvs_lab.tuning import KNOBS
from fvs_ros.params import ParameterSet


@pytest.mark.parametrize("knob", KNOBS, ids=lambda knob: knob.name)
def test_a_knob_turns_a_parameter_about_its_default(knob):
    assert knob.default in knob.values
    for value in knob.values:
        settings = knob.settings(value)
        if knob.of_estimator:
            ParameterSet(PARAMETERS).values(settings)
            defaults = ParameterSet(PARAMETERS).values({})
        else:
            default_values(**settings)
            defaults = default_values()
        if value == knob.default:
            assert {name: defaults[name] for name in settings} == pytest.approx(settings)


def test_a_quick_run_makes_a_complete_report(tmp_path):
    context = Context(tmp_path, jobs=2, quick=True, rendered=False)
    report = tuning.run(context)
    folder = context.folder(report.name)
    path = write_report(report, folder, Origin("", "", "", True))
    data = json.loads(path.read_text(encoding="utf-8"))["data"]
    assert len(data["runs"]) == 10
    for figure in report.figures:
        assert (folder / figure.file).stat().st_size > 10_000
    slow, usual = (data["runs"][f"max_joint_velocity_rad_s {v}"][0] for v in (0.25, 1.0))
    assert usual["settling_s"]["5 mm"] < 0.6 * slow["settling_s"]["5 mm"]
