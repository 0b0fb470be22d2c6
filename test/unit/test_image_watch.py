"""Does the image follow the arm? A frozen one is found, no moving ball ever is."""

import numpy as np
import pytest
from test_supervisor import WANTED, at_rest, servoing

from fvs_controller_node.image_watch import Image, ImageWatch
from fvs_controller_node.reasons import Reason, State

IMAGE_S = 1.0 / 30.0


def found_after_s(seen_of, speed_m_s=0.3, seconds=4.0, way_of=None):
    """When the watch first objects, s; None for never. ``seen_of`` and ``way_of`` are of time."""
    watch = ImageWatch()
    for k in range(round(seconds / IMAGE_S)):
        t = k * IMAGE_S
        way = np.array([speed_m_s * t, 0.0, 0.0]) if way_of is None else way_of(t)
        watch.add(Image(t, np.asarray(seen_of(t), dtype=float), way))
        if watch.unmoved is not None:
            return t
    return None


@pytest.mark.parametrize("noise_m", [0.0, 0.001, 0.002])
def test_a_picture_that_stands_while_the_arm_moves_is_found_within_half_a_second(noise_m):
    rng = np.random.default_rng(1)
    after_s = found_after_s(lambda t: [0.1, 0.2, 1.0] + noise_m * rng.normal(size=3))
    assert 0.39 < after_s < 0.5


def test_a_slow_arm_takes_as_long_as_its_way_and_a_creeping_one_says_nothing():
    assert 1.3 < found_after_s(lambda t: [0.0, 0.0, 1.0], speed_m_s=0.05) < 1.6
    assert 3.3 < found_after_s(lambda t: [0.0, 0.0, 1.0], speed_m_s=0.02) < 3.8
    assert found_after_s(lambda t: [0.0, 0.0, 1.0], speed_m_s=0.015) is None


def test_it_says_what_was_to_move_and_what_did():
    watch = ImageWatch()
    for k in range(14):
        watch.add(Image(k * IMAGE_S, np.array([0.001 * k, 0.0, 1.0]), np.array([0.01 * k, 0, 0])))
        watch.add(watch._images[-1])  # told at every tick, not at every image
    unmoved = watch.unmoved
    assert unmoved.predicted_m == pytest.approx(0.13, rel=0.1)
    assert unmoved.seen_m == pytest.approx(0.1 * unmoved.predicted_m)
    assert unmoved.time_s == pytest.approx(0.42, rel=0.1)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 180.0])
@pytest.mark.parametrize("share", [0.3, 1.0, 3.0])
def test_a_ball_that_moves_otherwise_than_predicted_still_moves(degrees, share):
    rng = np.random.default_rng(2)
    turned = share * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    assert found_after_s(lambda t: 0.3 * t * turned + 0.004 * rng.normal(size=3)) is None


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 3.0])
def test_to_and_fro_is_moving(rate_hz):
    rng = np.random.default_rng(3)

    def swing(t):
        return np.array([0.0, 0.06 * np.sin(2.0 * np.pi * rate_hz * t), 0.0])

    assert found_after_s(lambda t: swing(t) + 0.004 * rng.normal(size=3), way_of=swing) is None
    assert found_after_s(lambda t: np.zeros(3), way_of=swing) < 1.6


@pytest.mark.parametrize("step_m", [-0.3, -0.1, 0.1, 0.3])
def test_a_camera_that_is_bumped_is_no_frozen_picture(step_m):
    rng = np.random.default_rng(4)
    for bumped_s in np.arange(0.1, 1.5, 0.1):

        def seen(t, bumped_s=bumped_s):
            way = [0.3 * t, 0.0, 0.0] if t < bumped_s else [0.21 * t + step_m, 0.21 * t, 0.0]
            return way + 0.002 * rng.normal(size=3)

        assert found_after_s(seen) is None


def test_a_gap_between_images_and_a_start_begin_it_anew():
    watch = ImageWatch()
    for k in range(40):
        image = Image(k * IMAGE_S, np.zeros(3), np.array([0.01 * k, 0.0, 0.0]))
        watch.add(image)
    assert watch.unmoved
    watch.add(image._replace(stamp_s=image.stamp_s + 0.6))
    assert watch.unmoved is None
    watch.add(image._replace(stamp_s=image.stamp_s - 0.1))  # a clock that jumped back
    assert watch.unmoved is None


def test_the_supervisor_holds_names_it_and_wants_a_start():
    cell = servoing()
    tick = cell.supervisor.tick
    cell.supervisor.tick = lambda now_s, dt_s, joints, ball, law: tick(
        now_s, dt_s, joints, ball, law, image=Image(now_s, ball, 0.5 * joints[:3])
    )
    cell.wanted = 2.0 * WANTED
    since_s = cell.now_s
    command = cell.until(lambda c: c.state is State.HOLDING)
    assert command.reason is Reason.IMAGE_NOT_FOLLOWING
    assert cell.now_s - since_s < 0.5
    assert "the image does not follow the arm" in command.text
    assert "~/start" in command.text
    cell.until(at_rest)
    assert cell.run(1.0).reason is Reason.IMAGE_NOT_FOLLOWING
    assert cell.supervisor.start(cell.now_s)[0]
    assert cell.run(0.2).state is State.SERVOING
