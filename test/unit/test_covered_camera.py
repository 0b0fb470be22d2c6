"""A hand on the lens: no ball, black images, whichever way the images are made."""

import copy
from dataclasses import replace

import pytest

from fvs_sim_node.config import SimConfig
from fvs_sim_node.frame_worker import FrameWorker
from fvs_sim_node.simulation import Simulation

SMALL = SimConfig(image_width=320, image_height=240)


def assert_black(frame):
    assert frame.rgb.shape == (240, 320, 3)
    assert not frame.rgb.any()
    assert not frame.depth_m.any()


@pytest.mark.parametrize("rendered", [True, False])
def test_a_covered_camera_sees_no_ball_and_an_open_one_sees_it_again(rendered):
    with Simulation(replace(SMALL, rendered=rendered)) as simulation:
        assert simulation.look().detection is not None
        simulation.covered = True
        simulation.reset()
        dark = simulation.look()
        assert dark.detection is None
        assert dark.covered
        simulation.covered = False
        assert simulation.look().detection is not None


def test_full_frames_of_a_covered_camera_are_black_here_and_from_the_worker():
    worker = FrameWorker(SMALL)
    try:
        with Simulation(SMALL) as simulation:
            simulation.full_frames = True
            for simulation.covered in (True, False):
                seen = simulation.look()
                assert worker.expose(seen, 1.0)
                assert not worker.expose(seen, 1.0)
                assert worker._pipe.poll(60.0)
                for frame in (seen.frame, copy.deepcopy(worker.finished())):
                    assert frame.rgb.any() != simulation.covered
                    if simulation.covered:
                        assert_black(frame)
    finally:
        worker.close()
