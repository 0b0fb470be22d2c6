import numpy as np
import pytest

from fvs_ros.core.params import Parameter, ParameterError, ParameterSet

GAIN = Parameter("gain", 1.0, "A gain.", minimum=0.0, maximum=10.0)
BOX = Parameter("box", [0.1] * 3, "A box.", size=3, minimum=0.0, broadcast=True)


@pytest.mark.parametrize("value", [2, 2.0, np.float64(2.0), np.int64(2)])
def test_whole_numbers_are_welcome_where_a_number_is_wanted(value):
    checked = GAIN.check(value)
    assert checked == 2.0
    assert type(checked) is float


@pytest.mark.parametrize("value", ["2", True, None, float("nan"), float("inf"), -0.1, 10.1, [1.0]])
def test_a_wrong_value_is_refused_with_what_was_expected(value):
    with pytest.raises(ParameterError, match="gain must be number from 0 to 10"):
        GAIN.check(value)


@pytest.mark.parametrize("value", [[0.1, 0.2], "abc", [0.1, 0.2, -0.3], [0.1, 0.2, "x"], None])
def test_a_wrong_list_is_refused(value):
    with pytest.raises(ParameterError, match="box must be a list of 3 numbers"):
        BOX.check(value)


def test_one_number_stands_for_a_whole_list_where_declared():
    assert BOX.check(0.3) == [0.3, 0.3, 0.3]
    with pytest.raises(ParameterError):
        Parameter("plain", [0.1, 0.2], "A list.", size=2).check(0.3)


def test_choices_and_types():
    law = Parameter("law", "ftsm", "A law.", choices=("ftsm", "mpc"))
    assert law.check("mpc") == "mpc"
    with pytest.raises(ParameterError, match="one of ftsm, mpc"):
        law.check("pid")
    with pytest.raises(ParameterError):
        Parameter("count", 3, "A count.").check(3.5)
    with pytest.raises(ParameterError):
        Parameter("flag", True, "A flag.").check(1)


def test_a_set_knows_its_names():
    parameters = ParameterSet([GAIN, BOX])
    assert parameters.values({"gain": 3}) == {"gain": 3.0, "box": [0.1] * 3}
    with pytest.raises(ParameterError, match=r"'gian'; did you mean gain\? known are box, gain"):
        parameters.values({"gian": 3})
    with pytest.raises(ValueError, match="declared twice"):
        ParameterSet([GAIN, GAIN])
