from fvs_ros.timeline import StampGate


def test_a_message_passes_when_it_is_newer_or_the_clock_was_set():
    gate = StampGate()
    stamps = [5.0, 5.0, 5.1, 5.04, 5.1, 5.11, 4.8, 4.8, 4.81, 99.0]
    passed = [True, False, True, False, False, True, True, False, True, True]
    assert [gate.advances(stamp_s) for stamp_s in stamps] == passed
