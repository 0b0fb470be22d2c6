"""A tag's pose, servoed in lock step: every scheme, rendered images, and a camera that is moved.

Errors are lengths: a degree counts 5 mm, at the lever arm of 0.3 m.
"""

import numpy as np
import pytest
from cases import each
from lock_step import EXACT_POSE, GOAL_RAD, START_RAD, feature_at, loop_from, run

from fvs_controller_node.reasons import Reason
from fvs_estimator_node.camera import PoeEstimator
from fvs_lab.trials import simulation_of
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import BEYOND, SCHEMES


def loop_and_target(scheme):
    simulation = simulation_of(EXACT_POSE)
    target = feature_at(simulation, GOAL_RAD)
    return loop_from(scheme, START_RAD, simulation), target


@each("scheme", [*SCHEMES, *BEYOND])
def test_every_scheme_settles_in_position_and_angle(scheme):
    loop, target = loop_and_target(scheme)
    _, errors_m = run(loop, target, 3.0)
    assert errors_m[-125:].max() < 0.005
    assert loop.loop.supervisor.last.reason is Reason.SETTLED


def test_an_arm_of_five_joints_brings_a_tag_where_it_shall_be_and_look():
    with Simulation(SimConfig(robot="so101", feature="pose", rendered=False)) as simulation:
        kind = Pose(task_axes="position_y")
        home = simulation.joints_rad
        goal = feature_at(simulation, home + [0.2, 0.1, -0.15, 0.2, 0.3])
        free = rotation_from_vector(np.array([0.0, 1.0, 0.0]))  # no pose of this arm has both
        target = kind.of_body(goal[:3], kind.rotation(goal) @ free)
        simulation.reset(home)
        values = {"law": "minimum_time", "task_axes": kind.task_axes, "singular_hold_m_rad": 0.004}
        estimator = PoeEstimator(simulation.true_chain(kind), kind=kind)
        with pytest.raises(ValueError, match="needs 6 joints or more, got 5"):
            ClosedLoop(simulation, PoeEstimator(simulation.true_chain(Pose()), kind=Pose()))
        loop = ClosedLoop(simulation, estimator, values)
        loop.run(0.5)
        run(loop, target, 2.0)
        assert loop.loop.supervisor.last.reason is Reason.SETTLED
        assert np.linalg.norm(kind.error(loop.true_feature, target)) < 1e-3


def test_rendered_images_bring_it_to_rest_within_a_millimetre_and_a_tenth_of_a_degree():
    simulation = Simulation(SimConfig(feature="pose"))
    target = feature_at(simulation, GOAL_RAD)
    loop = loop_from("best", START_RAD, simulation)
    run(loop, target, 2.0)
    errors = [loop.kind.minus(loop.true_feature, target) for _ in range(125) if loop.tick()]
    way_m, arc_m = np.sqrt(np.mean(np.square(errors), axis=0)).reshape(2, 3)
    assert np.linalg.norm(way_m) < 1e-3
    assert np.linalg.norm(arc_m) / loop.kind.unit[-1] < np.radians(0.1)


def test_a_camera_that_is_turned_and_moved_costs_little_time():
    loop, target = loop_and_target("best")
    undisturbed_s = loop.period_s * np.flatnonzero(run(loop, target, 2.0)[1] > 0.005)[-1]
    loop, _ = loop_and_target("best")
    camera = loop.simulation.camera.rotated(np.radians([8.0, -12.0, 13.0]))
    loop.simulation.camera = camera.moved(np.array([0.06, -0.05, 0.06]))
    loop.run(0.3)
    target = loop.simulation.true_chain(loop.kind).position(GOAL_RAD)
    late = run(loop, target, 2.0)[1] > 0.005
    assert loop.period_s * np.flatnonzero(late)[-1] < 1.3 * undisturbed_s + 0.05
