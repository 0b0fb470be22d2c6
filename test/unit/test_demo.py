import numpy as np

from fvs_tools.demo import TargetRecord, score, table


def test_a_target_that_late_inputs_slowed_is_marked():
    records = [TargetRecord(np.zeros(3), 1.0, slowed=slowed) for slowed in (False, True)]
    for record in records:
        record.balls += [(0.0, np.array([0.3, 0.0, 0.0])), (2.0, np.zeros(3))]
    _, punctual, slowed = table([score(one) for one in records]).splitlines()
    assert punctual.endswith("rad/s")
    assert slowed.endswith("slowed: inputs came late")
