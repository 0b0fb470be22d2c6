"""A serial chain: its derivative, another camera, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each
from scipy.spatial.transform import Rotation

from fvs_ros import ros
from fvs_ros.chain import CHAIN_SHAPES, SerialChain
from fvs_ros.kinds.ball import Ball


def random_chain(seed=0, joints=6, features=3, on_arm=False):
    rng = np.random.default_rng(seed)
    lengths = {"n": joints, "m": features}
    shapes = ([lengths.get(side, side) for side in sides] for sides in CHAIN_SHAPES.values())
    *numbers, prismatic, lens, play = (rng.normal(size=shape) for shape in shapes)
    play_rad = np.clip(play, 0.0, 0.1)
    return SerialChain(*numbers, prismatic > 0.5, 0.1 * lens, on_arm, play_rad)


@each("on_arm", [False, True])
@each("features", [3, 12])
@each("count", [1, 4, 6, 7])
def test_the_jacobian_is_the_derivative_of_the_position(count, features, on_arm):
    chain = random_chain(count, count, features, on_arm)
    joints = np.random.default_rng(count).uniform(-3.0, 3.0, (20, count))
    step = 1e-6
    columns = [
        (chain.position(joints + step * unit) - chain.position(joints - step * unit)) / (2 * step)
        for unit in np.eye(count)
    ]
    np.testing.assert_allclose(chain.jacobian(joints), np.stack(columns, axis=-1), atol=1e-8)
    position, jacobian = chain.position_and_jacobian(joints[0])
    np.testing.assert_allclose(position, chain.position(joints)[0], atol=1e-12)
    np.testing.assert_allclose(jacobian, chain.jacobian(joints)[0], atol=1e-12)


def test_a_moved_camera_sees_the_same_arm_elsewhere():
    chain, rng = random_chain(features=6), np.random.default_rng(2)
    rotation, translation = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    joints = rng.normal(size=(10, 6))
    position, jacobian = chain.position_and_jacobian(joints)
    moved = chain.moved(rotation, translation)
    seen = position.reshape(10, 2, 3) @ rotation.T + [translation, np.zeros(3)]
    np.testing.assert_allclose(moved.position(joints), seen.reshape(10, 6), atol=1e-12)
    columns = rotation @ jacobian.reshape(10, 2, 3, 6)
    np.testing.assert_allclose(moved.jacobian(joints), columns.reshape(10, 6, 6), atol=1e-12)


def test_a_camera_on_the_arm_sees_the_room_move_the_other_way():
    ahead, joints = random_chain(features=12), np.random.default_rng(3).uniform(-3.0, 3.0, 6)
    back = replace(ahead, on_arm=True)
    # What rides on the arm is, in the room, where the room is, seen from it, the other way round.
    there = np.insert(ahead.feature_m.reshape(4, 3), 3, [1.0, 0.0, 0.0, 0.0], axis=1)
    np.testing.assert_allclose(
        ahead.transform(joints) @ back.transform(joints), np.eye(4), atol=1e-9
    )
    seen = (there @ back.transform(joints))[:, :3].ravel()
    np.testing.assert_allclose(back.position(joints), seen, atol=1e-12)
    np.testing.assert_allclose(back.anchored(joints, seen).feature_m, back.feature_m, atol=1e-9)


@each("on_arm", [False, True])
def test_a_chain_comes_back_from_its_message(on_arm):
    chain = random_chain(on_arm=on_arm)
    message, kinds = ros.to_chain(chain), (Ball(), Ball(camera_mount="arm"))
    back = ros.from_chain(message, 6, kinds[on_arm])
    for name in CHAIN_SHAPES:
        np.testing.assert_allclose(getattr(back, name), getattr(chain, name), atol=1e-15)
    assert back.on_arm == on_arm
    with pytest.raises(ros.MessageError, match="cannot be used: camera_mount"):
        ros.from_chain(message, 6, kinds[not on_arm])


@each("name", CHAIN_SHAPES)
def test_a_number_that_is_not_finite_or_beyond_reason_is_refused(name):
    for bad in (np.nan, np.inf, 1e9):
        values = {field: np.array(getattr(random_chain(), field)) for field in CHAIN_SHAPES}
        values[name].flat[-1] = bad
        with pytest.raises(ValueError, match=f"{name}.*(not finite|number above)"):
            SerialChain(**values)
    values[name] = values[name][:-1]
    with pytest.raises(ValueError, match=r"has shape|carries 2 numbers"):
        SerialChain(**values)
