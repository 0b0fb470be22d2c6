"""A hand on the lens: no ball, black images, whichever way the images are made."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from fvs_sim_node.frame_worker import FrameWorker
from fvs_sim_node.simulation import SimConfig, Simulation

SMALL = SimConfig(image_width=320, image_height=240)


def look(simulation, covered):
    simulation.covered = covered
    return simulation.look()


@pytest.mark.parametrize("rendered", [True, False])
@pytest.mark.parametrize("full_frames", [True, False])
def test_a_covered_camera_sees_no_ball_and_an_open_one_sees_it_again(rendered, full_frames):
    with Simulation(replace(SMALL, rendered=rendered)) as simulation:
        simulation.full_frames = full_frames
        assert look(simulation, covered=False).detection is not None
        dark = look(simulation, covered=True)
        assert dark.detection is None
        assert dark.covered
        assert look(simulation, covered=False).detection is not None


def test_a_full_frame_of_a_covered_camera_is_black_and_without_depth():
    with Simulation(SMALL) as simulation:
        simulation.full_frames = True
        frame = look(simulation, covered=True).frame
        assert frame.rgb.shape == (240, 320, 3)
        assert not frame.rgb.any()
        assert not frame.depth_m.any()
        assert frame.depth_m.dtype == np.float32
        assert look(simulation, covered=False).frame.rgb.any()


def test_a_cover_stays_over_a_reset():
    with Simulation(SMALL) as simulation:
        simulation.covered = True
        simulation.reset()
        assert simulation.look().detection is None


def test_the_frame_worker_draws_a_covered_camera_black():
    with Simulation(SMALL) as simulation:
        worker = FrameWorker(SMALL)
        try:
            frames = []
            for covered in (True, False):
                assert worker.expose(
                    1.0, simulation.joints_rad, simulation.camera, 1.0, covered=covered
                )
                assert worker._pipe.poll(20.0)
                frames.append(copy.deepcopy(worker.finished()))
        finally:
            worker.close()
    dark, light = frames
    assert not dark.rgb.any()
    assert not dark.depth_m.any()
    assert dark.rgb.shape == light.rgb.shape
    assert light.rgb.any()
    assert light.depth_m.any()
