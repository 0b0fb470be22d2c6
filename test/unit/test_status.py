"""Reading statuses."""

from math import isnan

import numpy as np
import pytest

from fvs_ros.status import number, vector


@pytest.mark.parametrize("text", [None, "", "unknown", "nan"])
def test_what_is_missing_or_unknown_is_no_number(text):
    assert isnan(number({} if text is None else {"error_m": text}, "error_m"))


def test_a_vector_is_known_only_as_a_whole():
    values = {"target_x_m": "0.1", "target_y_m": "-2e-3", "target_z_m": "1.4"}
    assert np.array_equal(vector(values, "target_{}_m"), [0.1, -0.002, 1.4])
    for text in ("inf", "unknown", ""):
        assert vector({**values, "target_y_m": text}, "target_{}_m") is None
    assert vector(values, "position_{}_m") is None
