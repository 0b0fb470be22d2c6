"""Colour and depth are paired by stamp, whatever comes in whatever order."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_detector_node.synchroniser import Synchroniser


def feed(pairing, events):
    """Pairs as (colour, depth) stamps, ms, of events like ('c', ms) and ('d', ms)."""
    found = []
    for stream, stamp_ms in events:
        add = pairing.add_colour if stream == "c" else pairing.add_depth
        pair = add(stamp_ms / 1000, stamp_ms)
        if pair is not None:
            found.append((pair.colour, pair.depth))
    return found


def frames(*numbers, offset_ms=0):
    """Colour and depth of 30 Hz frames."""
    for n in numbers:
        yield "c", 100 * n // 3
        yield "d", 100 * n // 3 + offset_ms


@pytest.mark.parametrize("order", ["cd", "dc"])
def test_equal_stamps_are_paired_at_once(order):
    pairing = Synchroniser(0.015)
    for n in range(5):
        first, second = order
        assert feed(pairing, [(first, 33 * n)]) == []
        assert feed(pairing, [(second, 33 * n)]) == [(33 * n, 33 * n)]


def test_the_nearest_within_the_tolerance_is_taken_and_an_offset_beyond_it_is_reported():
    assert feed(Synchroniser(0.015), [("d", 88), ("d", 104), ("c", 100)]) == [(100, 104)]
    pairing = Synchroniser(0.005)
    assert feed(pairing, frames(1, 2, 3, 4, offset_ms=9)) == []
    assert pairing.offset_s == pytest.approx(0.009)
    pairing.tolerance_s = 0.02
    assert feed(pairing, frames(5, 6, offset_ms=9))[-2:] == [(166, 175), (200, 209)]


def test_repeated_and_late_images_pair_nothing():
    pairing = Synchroniser(0.015)
    assert len(feed(pairing, frames(10, 11))) == 2
    assert feed(pairing, frames(11, 11, 10, 9, 11)) == []
    assert pairing.repeats > 0
    assert feed(pairing, frames(12)) == [(400, 400)]
    assert pairing.repeats == 0


def test_a_lost_image_costs_one_pair():
    events = [e for e in frames(1, 2, 3, 4) if e != ("d", 66)]
    assert [colour for colour, _ in feed(Synchroniser(0.015), events)] == [33, 100, 133]


def test_a_clock_set_back_starts_anew_and_one_wrong_stamp_does_not():
    pairing = Synchroniser(0.015)
    feed(pairing, frames(300, 301))
    assert feed(pairing, [("c", 5), ("d", 5), ("c", 5), ("d", 5)]) == []
    assert pairing.restarts == 0
    assert feed(pairing, frames(302)) == [(10066, 10066)]
    feed(pairing, [("c", 10**9), ("d", 10**9)])
    found = feed(pairing, frames(*range(303, 313)))
    assert found[-1][0] == 10400
    assert len(found) >= 5
    assert feed(pairing, frames(*range(1, 10)))[-1] == (300, 300)
    assert pairing.restarts >= 2


STAMPS_MS = st.integers(-50, 400) | st.sampled_from([-(10**9), 10**9, 10**6])


@given(st.lists(st.tuples(st.sampled_from("cd"), STAMPS_MS), max_size=120))
@settings(max_examples=300, deadline=None)
def test_pairs_advance_and_keep_the_tolerance_whatever_comes(events):
    pairing = Synchroniser(0.015)
    last_s, restarts = float("-inf"), 0
    for stream, stamp_ms in events:
        add = pairing.add_colour if stream == "c" else pairing.add_depth
        pair = add(stamp_ms / 1000, stamp_ms)
        if pairing.restarts != restarts:
            last_s, restarts = float("-inf"), pairing.restarts
        if pair is not None:
            assert abs(pair.depth_stamp_s - pair.stamp_s) <= 0.015
            assert pair.stamp_s > last_s
            last_s = pair.stamp_s
    found = feed(pairing, frames(*range(10**8, 10**8 + 30)))
    assert len(found) >= 20
