"""A rig for the fault campaign, which the tests of a module share."""

import pytest


class _Shelf:
    """Keeps one rig, as long as it is fit for another test."""

    def __init__(self, make_folder):
        self._make_folder = make_folder
        self._rig = None

    def take(self):
        """A rig at rest: the last one if it still goes, else a new one."""
        if self._rig is not None:
            try:
                self._rig.renew()
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
    """The whole robot at rest; afterwards every command of the test is looked at."""
    from rig import assert_sound

    rig = _shelf.take()
    yield rig
    print(f"zero {1e3 * rig.stop_s:.0f} ms after the fault")  # pytest -rP shows it
    assert_sound(rig.commands, rig.started_s)
