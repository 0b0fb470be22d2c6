import numpy as np
import pytest
from cases import each

from fvs_ros.params import Parameter, ParameterError, ParameterSet

GAIN = Parameter("gain", 1.0, "A gain.", minimum=0.0, maximum=10.0)
BOX = Parameter("box", [0.1] * 3, "A box.", minimum=0.0, broadcast=True)


def test_a_whole_number_is_taken_for_a_number_and_one_for_a_list_where_declared():
    assert {type(GAIN.check(x)) for x in (2, np.float64(2.0), np.int64(2))} == {float}
    assert BOX.check(2) == [2.0]
    assert [GAIN.check("5e-2"), *BOX.check("1e-4"), *BOX.check(["1e-4", 2])] == [
        0.05,
        1e-4,
        1e-4,
        2,
    ]


@each(
    ("parameter", "wrong", "words"),
    [
        (
            GAIN,
            ("2 m", True, None, np.nan, np.inf, -0.1, 10.1, [1.0]),
            "gain must be number from 0",
        ),
        (BOX, ("abc", [0.1, 0.2, -0.3], [0.1, 0.2, "x"], None), "box must be a list of numbers"),
        (Parameter("plain", [0.1, 0.2], "A list.", size=2), (0.3, [0.3]), "a list of 2 numbers"),
        (Parameter("law", "ftsm", "A law.", choices=("ftsm", "mpc")), ("pid",), "one of ftsm, mpc"),
        (Parameter("count", 3, "A count."), (3.5, True), "whole number"),
        (Parameter("flag", True, "A flag."), (1, "true"), "true or false"),
    ],
)
def test_a_wrong_value_is_refused_with_what_was_expected(parameter, wrong, words):
    for value in wrong:
        with pytest.raises(ParameterError, match=words):
            parameter.check(value)


def test_a_set_knows_its_names():
    parameters = ParameterSet([GAIN, BOX])
    assert parameters.values({"gain": 3}) == {"gain": 3.0, "box": [0.1] * 3}
    with pytest.raises(ParameterError, match=r"'gian'; did you mean gain\? known are box, gain"):
        parameters.values({"gian": 3})
    with pytest.raises(ValueError, match="declared twice"):
        ParameterSet([GAIN, GAIN])
