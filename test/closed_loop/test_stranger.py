"""Collect, train, servo: a robot and a camera that the package has never seen, without ROS."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stranger import Stranger, StrangerConfig
from stranger_trial import collect, draw_targets, jacobian_error, servo

from fvs_estimator_node.training import TrainingOptions, train


@pytest.mark.parametrize(("seed", "rate_hz"), [(1, 250.0)])
def test_a_stranger_is_learned_in_two_minutes_and_served(seed, rate_hz):
    stranger = Stranger(StrangerConfig(seed=seed, joint_state_rate_hz=rate_hz))
    data = collect(stranger, 120.0)
    assert len(data) > 3400
    model = train(data, TrainingOptions(method="ridge")).trained.model
    rng = np.random.default_rng(seed)
    assert jacobian_error(model, stranger, rng) < 0.06
    for arrival in servo(stranger, model, draw_targets(stranger, rng, count=3)):
        assert arrival.settled_s < 2.0
        assert arrival.final_rms_m < 0.0015
