"""Rigs for the fault campaign: one for all tests of a module, or one with settings of its own."""

import pytest


class _Shelf:
    """Keeps one rig, as long as it is fit for another test."""

    def __init__(self, make_folder):
        self._make_folder = make_folder
        self._rig = None

    def take(self):
        """A rig at home: the last one if it still goes, else a new one."""
        if self._rig is not None:
            try:
                assert self._rig.complete()
                self._rig.rewind()
            except AssertionError:
                self.clear()
        if self._rig is None:
            from rig import Rig  # brings rclpy

            self._rig = Rig(self._make_folder("rig"))
        return self._rig

    def clear(self):
        """End the rig."""
        if self._rig is not None:
            self._rig.close()
            self._rig = None


@pytest.fixture(scope="module")
def _shelf(tmp_path_factory):
    shelf = _Shelf(tmp_path_factory.mktemp)
    yield shelf
    shelf.clear()


@pytest.fixture
def rig(_shelf):
    """The whole robot, at home; afterwards every command of the test is looked at."""
    rig = _shelf.take()
    yield rig
    if rig.stop_s is not None:
        print(f"zero {1e3 * rig.stop_s:.0f} ms after the fault")  # pytest -rP shows it
    rig.assert_sound()


@pytest.fixture
def make_rig(_shelf, tmp_path):
    """As ``rig``, with settings of one's own."""
    from rig import Rig

    _shelf.clear()  # two at a time would only slow each other down
    rigs = []

    def make(**settings):
        rigs.append(Rig(tmp_path, **settings))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()
    for rig in rigs:
        rig.assert_sound()
