"""Targets relative to an object: taught and found again, moved, hidden, and wrongly seen."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each
from lock_step import EXACT_POSE, GOAL_RAD, START_RAD, feature_at, loop_from

from fvs_controller_node.reasons import Reason, State
from fvs_controller_node.relation import OBJECT_FRAME, Lens
from fvs_estimator_node.camera import PoeEstimator
from fvs_estimator_node.loop import EstimationLoop
from fvs_lab.trials import Conditions, simulation_of
from fvs_ros.camera import CAMERA_FRAME
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop

KINDS = {
    "ball": Conditions(rendered=False, position_noise_m=3e-4),
    "pose": EXACT_POSE,
}
EVERY = 4  # joint states an image of the object


class Scene:
    """A loop, and an object that is seen with noise."""

    def __init__(self, feature, focal_error=0.0, known=True, **values):
        simulation = simulation_of(KINDS[feature])
        tool = feature_at(simulation, GOAL_RAD)
        self.loop = loop_from("best", START_RAD, simulation, **values)
        kind = self.kind = self.loop.kind
        self.generator = np.random.default_rng(4)
        # Beside the goal, and turned.
        motion_m = np.array([0.05, 0.08, -0.06, 0.1, -0.05, 0.2])[: kind.size]
        self.object = kind.retract(tool, motion_m)
        self.relative = kind.relative(tool, self.object)
        self.tick = 0
        self.lens = Lens(kind)
        if focal_error:
            self.lens.error = np.array([focal_error, 0.0])
            blurred = simulation._blurred
            simulation._blurred = lambda kind, z, rng: blurred(kind, self.lens.measured(z), rng)
            chain = replace(self.loop.estimation.estimator.chain, lens=known * self.lens.error)
            self.loop.estimation = EstimationLoop(PoeEstimator(chain, None, kind))

    def measured(self):
        noise_m = 3e-4 * self.generator.standard_normal(self.kind.size)
        return self.kind.retract(self.lens.measured(self.object), noise_m)

    def run(self, seconds, seen=measured):
        commands = []
        for _ in range(round(seconds / self.loop.period_s)):
            now_s = self.loop.simulation.time_s
            if self.tick % EVERY == 0 and seen is not None:
                self.loop.loop.add_object(now_s, now_s, seen(self))
            self.tick += 1
            commands.append(self.loop.tick())
        return commands

    def ask(self):
        accepted, text = self.loop.loop.add_target(self.relative, OBJECT_FRAME)
        assert accepted, text

    def teach(self):
        return self.loop.loop.teach(self.loop.simulation.time_s)

    @property
    def error_m(self):
        """Error of the relation, m."""
        target = self.kind.absolute(self.relative, self.object)
        return np.linalg.norm(self.kind.minus(self.loop.true_feature, target))


@pytest.fixture(params=KINDS)
def scene(request):
    return Scene(request.param, object_may_be_hidden_s=2.0, resume_within_s=3.0)


def test_a_taught_relation_is_found_again_beside_the_object_at_another_place(scene):
    scene.ask()
    scene.run(2.5)
    errors_m = [scene.error_m for _ in range(60) if scene.run(4 * scene.loop.period_s)]
    assert np.median(errors_m) < 3e-4
    taught = scene.teach()
    assert taught.frame == OBJECT_FRAME
    assert np.linalg.norm(scene.kind.minus(taught.z, scene.relative)) < 6e-4
    assert 2e-5 < taught.deviation_m < 2e-4
    motion_m = np.array([-0.08, 0.03, 0.05, 0.0, 0.1, 0.1])[: scene.kind.size]
    scene.object = scene.kind.retract(scene.object, motion_m)
    assert scene.loop.loop.go_to(taught)[0]
    scene.run(2.5)
    assert scene.error_m < 1.5e-3


@each(("known", "least_m", "most_m"), [(True, 0.0, 8e-4), (False, 3e-3, 0.01)])
def test_a_lens_that_is_known_to_err_does_not_stretch_the_relation(known, least_m, most_m):
    scene = Scene("pose", focal_error=0.05, known=known)
    scene.ask()
    scene.run(3.0)
    error_m = scene.error_m
    taught = scene.teach()
    del scene.loop.simulation._blurred
    assert least_m < error_m < most_m
    assert np.linalg.norm(scene.kind.minus(taught.z, scene.relative)) < 1e-3


def test_an_object_on_a_belt_is_followed(scene):
    velocity_m = np.zeros(scene.kind.size)
    velocity_m[0] = 0.1 * EVERY * scene.loop.period_s

    def carried(scene):
        scene.object = scene.kind.retract(scene.object, velocity_m)
        return scene.measured()

    scene.ask()
    scene.run(1.5)
    scene.run(1.0, carried)
    errors_m = [scene.error_m for _ in range(100) if scene.run(scene.loop.period_s, carried)]
    assert np.sqrt(np.mean(np.square(errors_m))) < 3e-3


def test_a_lone_wrong_image_moves_nothing_and_a_lasting_jump_is_a_new_target(scene):
    scene.ask()
    scene.run(2.5)
    jump_m, mirrored_m = np.zeros((2, scene.kind.size))
    jump_m[1], mirrored_m[3:4] = 0.1, 0.4  # a ball has no mirrored pose
    images = [scene.kind.retract(scene.object, off_m) for off_m in (mirrored_m, 0 * jump_m, jump_m)]
    commands = scene.run(0.2, lambda scene: images.pop() if images else scene.measured())
    assert max(np.abs(c.velocity_rad_s).max() for c in commands) < 0.05
    scene.object = scene.kind.retract(scene.object, jump_m)
    scene.run(2.5)
    assert scene.error_m < 1.5e-3


def test_an_object_that_stood_still_may_be_hidden(scene):
    scene.ask()
    scene.run(0.5)
    scene.run(1.9, None)
    assert scene.loop.loop.supervisor.last.state is State.SERVOING
    assert scene.error_m < 2e-3
    scene.run(0.5)
    assert scene.loop.loop.supervisor.last.state is State.SERVOING
    scene.run(2.6, None)
    assert scene.loop.loop.supervisor.last.reason is Reason.STALE


def test_an_object_that_moved_while_it_was_hidden_holds_the_arm(scene):
    scene.ask()
    scene.run(1.0)
    scene.run(1.0, None)
    scene.object = scene.kind.retract(scene.object, np.full(scene.kind.size, 0.02))
    commands = scene.run(0.5)
    assert commands[-1].reason is Reason.OBJECT_MOVED
    assert not commands[-1].velocity_rad_s.any()


@each("feature", KINDS)
def test_an_object_that_was_never_seen_holds_the_arm(feature):
    scene = Scene(feature)
    scene.ask()
    commands = scene.run(0.3, None)
    assert commands[-1].reason is Reason.MISSING
    assert "object" in commands[-1].text
    assert not any(c.velocity_rad_s.any() for c in commands)


def test_teaching_refuses_what_moves(scene):
    scene.ask()
    scene.run(0.5)
    with pytest.raises(ValueError, match="moved by"):
        scene.teach()


def test_teaching_refuses_a_tool_or_an_object_that_is_out_of_view(scene):
    scene.ask()
    scene.run(2.5)
    scene.run(1.5, None)
    assert scene.teach().frame == OBJECT_FRAME  # it may be hidden for 2 s
    scene.run(1.0, None)
    with pytest.raises(ValueError, match=r"object_.* is 2\.5 s old"):
        scene.teach()
    scene.run(1.0, None)
    assert scene.teach().frame == CAMERA_FRAME  # there is none any more
    now_s = scene.loop.simulation.time_s
    assert scene.loop.loop.set_current_as_target(now_s)[0]  # needs none, either
    scene.run(1.0)
    scene.loop.loop.add_image = lambda *_: None
    scene.run(0.5)
    with pytest.raises(ValueError, match=f"{scene.kind.topics.tool.name} is 0.5"):
        scene.teach()


@each("feature", KINDS)
def test_the_loop_follows_the_simulators_object_on_a_belt(feature):
    moving = {"object_tag_id": 10, "object_velocity_m_s": (0.0, 0.05, 0.0)}
    conditions = {"rendered": False, "position_noise_m": 3e-4}
    simulation = Simulation(SimConfig(feature=feature, **moving, **conditions))
    loop = ClosedLoop.of_scheme("best", simulation)
    kind = loop.kind
    relative = kind.relative(simulation.true_feature(), simulation.true_object())
    loop.run(0.2)
    accepted, text = loop.loop.add_target(relative, OBJECT_FRAME)
    assert accepted, text
    loop.run(1.5)
    target = kind.absolute(relative, simulation.true_object())
    assert np.linalg.norm(kind.minus(simulation.true_feature(), target)) < 3e-3
    simulation.close()


def test_an_object_that_a_slow_camera_sees_in_motion_is_none_that_was_hidden(scene):
    velocity_m = np.zeros(scene.kind.size)
    velocity_m[0] = 0.02 * 0.25  # 20 mm/s, at 4 Hz
    scene.ask()
    scene.run(1.0)
    for image in range(24):
        if image >= 12:
            scene.object = scene.kind.retract(scene.object, velocity_m)
        scene.tick = 0
        scene.run(scene.loop.period_s)
        commands = scene.run(0.25 - scene.loop.period_s, None)
        assert commands[-1].reason is not Reason.OBJECT_MOVED


def test_a_lone_wrong_image_does_not_shift_what_is_taught(scene):
    scene.run(0.5)
    scene.run(scene.loop.period_s, lambda s: s.kind.retract(s.object, np.full(s.kind.size, 0.05)))
    scene.run(0.5)
    taught = scene.teach()
    true = scene.kind.relative(scene.loop.true_feature, scene.object)
    assert np.linalg.norm(scene.kind.minus(taught.z, true)) < 1e-3


def test_an_object_in_the_grip_does_not_lead_the_arm_away(scene):
    scene.ask()
    scene.run(2.0)
    gripped = scene.kind.relative(scene.object, scene.loop.true_feature)

    def rides(scene):
        scene.object = scene.kind.absolute(gripped, scene.loop.true_feature)
        return scene.measured()

    start = scene.loop.true_feature
    further_m = np.zeros(scene.kind.size)
    further_m[0] = 0.05
    scene.relative = scene.kind.retract(scene.relative, further_m)
    scene.ask()
    commands = scene.run(3.0, rides)
    assert commands[-1].reason is Reason.OBJECT_RIDES
    assert np.linalg.norm(scene.kind.minus(scene.loop.true_feature, start)) < 0.25


def test_an_object_that_leaves_the_workspace_holds_the_arm(scene):
    scene.ask()
    scene.run(1.0)
    scene.object = scene.kind.retract(scene.object, np.eye(scene.kind.size)[0] * 3.0)
    commands = scene.run(0.5)
    assert commands[-1].reason is Reason.BAD_INPUT
    assert "workspace_max_m" in commands[-1].text


def test_where_a_hidden_object_stood_is_known_by_all_its_images(scene):
    scene.ask()
    scene.run(2.0)
    error_m = scene.error_m
    scene.run(1.0, None)
    assert scene.error_m < error_m + 2e-4


def test_a_hidden_object_that_stood_still_serves_the_next_reference_as_well(scene):
    scene.ask()
    scene.run(1.5)
    scene.run(0.3, None)
    back_m = 0.05 * np.eye(scene.kind.size)[2]
    scene.relative = scene.kind.retract(scene.relative, back_m)
    scene.ask()
    commands = scene.run(1.0, None)
    assert {command.state for command in commands} == {State.SERVOING}
    assert scene.error_m < 2e-3


def test_an_object_that_moved_under_an_absolute_target_may_not_be_hidden(scene):
    scene.ask()
    scene.run(1.0)
    loop = scene.loop.loop
    assert loop.add_target(scene.loop.true_feature, loop.supervisor.config.feature_frame)[0]
    scene.object = scene.kind.retract(scene.object, np.full(scene.kind.size, 0.02))
    scene.run(0.1)
    scene.run(0.5, None)
    scene.ask()
    assert scene.run(0.1, None)[-1].reason is Reason.STALE
