"""Reading statuses, and that nobody reads them in another way."""

from math import isnan
from pathlib import Path

import numpy as np
import pytest

from fvs_ros.core.status import number, vector

APPS = Path(__file__).resolve().parents[2] / "fvs_ros" / "apps"


@pytest.mark.parametrize("text", [None, "", "unknown", "nan"])
def test_what_is_missing_or_unknown_is_no_number(text):
    assert isnan(number({} if text is None else {"error_m": text}, "error_m"))


def test_a_vector_is_known_only_as_a_whole():
    values = {"target_x_m": "0.1", "target_y_m": "-2e-3", "target_z_m": "1.4"}
    assert np.array_equal(vector(values, "target_{}_m"), [0.1, -0.002, 1.4])
    for text in ("inf", "unknown", ""):
        assert vector({**values, "target_y_m": text}, "target_{}_m") is None
    assert vector(values, "position_{}_m") is None


@pytest.mark.parametrize("path", ["replay", "markers.py"])
def test_replay_and_markers_do_without_the_page(path):
    files = sorted((APPS / path).glob("*.py")) or [APPS / path]
    for file in files:
        assert "fvs_ros.apps.dashboard" not in file.read_text(encoding="utf-8"), file
