from dataclasses import dataclass, field

import numpy as np
import pytest

from fvs_ros.params import Parameter, ParameterError, Parameters, ParameterSet, parameter

GAIN = Parameter("gain", 1.0, "A gain.", minimum=0.0, maximum=10.0)
BOX = Parameter("box", [0.1] * 3, "A box.", minimum=0.0, broadcast=True)


def test_a_whole_number_is_taken_for_a_number_and_one_for_a_list_where_declared():
    assert [type(GAIN.check(one)) for one in (2, np.float64(2.0), np.int64(2))] == [float] * 3
    assert BOX.check(2) == [2.0]


@pytest.mark.parametrize(
    ("one", "wrong", "words"),
    [
        (GAIN, ("2", True, None, np.nan, np.inf, -0.1, 10.1, [1.0]), "gain must be number from 0"),
        (BOX, ("abc", [0.1, 0.2, -0.3], [0.1, 0.2, "x"], None), "box must be a list of numbers"),
        (Parameter("plain", [0.1, 0.2], "A list.", size=2), (0.3, [0.3]), "a list of 2 numbers"),
        (Parameter("law", "ftsm", "A law.", choices=("ftsm", "mpc")), ("pid",), "one of ftsm, mpc"),
        (Parameter("count", 3, "A count."), (3.5, True), "whole number"),
        (Parameter("flag", True, "A flag."), (1, "true"), "true or false"),
    ],
)
def test_a_wrong_value_is_refused_with_what_was_expected(one, wrong, words):
    for value in wrong:
        with pytest.raises(ParameterError, match=words):
            one.check(value)


def test_a_set_knows_its_names():
    parameters = ParameterSet([GAIN, BOX])
    assert parameters.values({"gain": 3}) == {"gain": 3.0, "box": [0.1] * 3}
    with pytest.raises(ParameterError, match=r"'gian'; did you mean gain\? known are box, gain"):
        parameters.values({"gian": 3})
    with pytest.raises(ValueError, match="declared twice"):
        ParameterSet([GAIN, GAIN])


@dataclass(frozen=True)
class Limits(Parameters):
    speed_rad_s: float = parameter(1.0, "Fastest.", 0.01, 3.0, live=True)
    box_m: tuple[float, ...] = parameter((0.1, 0.2), "A box.", 0.0, size=2)


@dataclass(frozen=True)
class Whole(Parameters):
    law: str = parameter("ftsm", "A law.", choices=("ftsm", "mpc"))
    limits: Limits = field(default_factory=Limits)
    inner: int = 3  # no parameter


def test_a_dataclass_declares_its_fields_and_those_of_its_parts():
    declared = {one.name: one for one in Whole.declared("arm.")}
    assert list(declared) == ["arm.law", "arm.speed_rad_s", "arm.box_m"]
    assert declared["arm.box_m"].default == [0.1, 0.2]
    assert (declared["arm.speed_rad_s"].live, declared["arm.law"].live) == (True, False)
    ParameterSet(declared.values())


def test_a_dataclass_is_made_of_values_and_checks_them():
    made = Whole.from_values({"arm.law": "mpc", "arm.box_m": [1, 2], "other": 7}, "arm.")
    assert made == Whole("mpc", Limits(box_m=(1.0, 2.0)))
    for wrong in ({"speed_rad_s": 4.0}, {"box_m": [1.0]}, {"law": "pid"}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            Whole.from_values(wrong)
