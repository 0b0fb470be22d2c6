"""Colour and depth images are paired by stamps, whatever comes in whatever order."""

from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_detector_node.pairing import Pairing

STAMPS_MS = st.integers(-50, 400) | st.sampled_from([-(10**9), 10**9, 10**6])


@given(st.lists(st.tuples(st.sampled_from(["colour", "depth"]), STAMPS_MS), max_size=120))
@settings(max_examples=200, deadline=None)
def test_pairs_advance_and_keep_the_tolerance_whatever_comes(events):
    pairing = Pairing(0.015)
    last_s, restarts = float("-inf"), 0
    for name, stamp_ms in events:
        pair = pairing.add(name, stamp_ms / 1000, stamp_ms)
        if pairing.restarts != restarts:
            last_s, restarts = float("-inf"), pairing.restarts
        if pair is not None:
            assert abs(pair.depth - pair.colour) <= 15
            assert pair.stamp_s > last_s
            last_s = pair.stamp_s
    later_ms = [100 * n // 3 for n in range(10**8, 10**8 + 30)]
    pairs = [pairing.add(name, ms / 1000, ms) for ms in later_ms for name in ("colour", "depth")]
    assert sum(pair is not None for pair in pairs) >= 20


def test_the_nearest_of_frequent_depth_images_is_taken_although_it_comes_later():
    pairing, offsets_ms = Pairing(0.015), []
    events = [("depth", 11 * n) for n in range(60)] + [("colour", 33 * n + 8) for n in range(20)]
    for name, stamp_ms in sorted(events, key=lambda event: event[1]):
        pair = pairing.add(name, stamp_ms / 1000, stamp_ms)
        if pair is not None:
            offsets_ms.append(pair.depth - pair.colour)
    assert len(offsets_ms) >= 18
    assert set(offsets_ms[1:]) == {3}
