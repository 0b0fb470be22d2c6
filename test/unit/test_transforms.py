"""The links' transforms, checked against the closed form and against another reader of URDF."""

import numpy as np
import pytest

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.kinematics import flange_pose
from fvs_sim_node.ur5_urdf import urdf_text
from fvs_tools.transforms import Links

#: ``base_link`` is the closed form's base, turned by half a turn.
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def matrix(transform):
    """Of a transform, shape (4, 4)."""
    x, y, z, w = transform.quaternion_xyzw
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    found = np.eye(4)
    found[:3, :3] += 2.0 * w * cross + 2.0 * cross @ cross
    found[:3, 3] = transform.translation_m
    return found


def placed(transforms, frame, root="base_link"):
    """Where a frame stands in the root."""
    by_child = {one.child: one for one in transforms}
    found = np.eye(4)
    while frame != root:
        found = matrix(by_child[frame]) @ found
        frame = by_child[frame].parent
    return found


@pytest.mark.parametrize("prefix", ["", "left_"])
@pytest.mark.parametrize("seed", range(5))
def test_the_flange_is_where_the_closed_form_says(prefix, seed):
    joints_rad = np.random.default_rng(seed).uniform(-3.0, 3.0, 6)
    links = Links(urdf_text(prefix))
    names = [prefix + name for name in UR_JOINT_NAMES]
    tree = (*links.fixed, *links.moved(dict(zip(names, joints_rad, strict=True))))
    found = placed(tree, f"{prefix}tool0", f"{prefix}base_link")
    np.testing.assert_allclose(found, HALF_TURN @ flange_pose(joints_rad), atol=1e-6)


def of_joint(kind, more=""):
    return (
        f'<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="{kind}">'
        f'<origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><parent link="a"/><child link="b"/>'
        f'{more}</joint><ros2_control><joint name="j"><state_interface name="position"/></joint>'
        "</ros2_control></robot>"
    )


def test_a_joint_that_slides_does_so_along_its_own_axis():
    links = Links(of_joint("prismatic", '<axis xyz="2 0 0"/>'))
    (slid,) = links.moved({"j": 0.5})
    np.testing.assert_allclose(slid.translation_m, [1.0, 2.5, 3.0], atol=1e-12)
    np.testing.assert_allclose(slid.quaternion_xyzw, [0.0, 0.0, 0.5**0.5, 0.5**0.5])


def test_an_origin_turns_about_fixed_axes_one_after_the_other():
    turned = Links(of_joint("fixed").replace("0 0 1.57", "1.5707963267948966 0 1.57")).fixed[0]
    # The child's y looks up, its z where the parent's x does.
    np.testing.assert_allclose(matrix(turned)[:3, 1], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(matrix(turned)[:3, 2], [1.0, 0.0, 0.0], atol=1e-12)


def test_what_is_not_known_is_left_out():
    links = Links(of_joint("revolute"))
    assert links.fixed == ()
    assert links.moved({"other": 1.0}) == []
    assert links.moved({"j": float("nan")}) == []
    assert Links(of_joint("floating")).moved({"j": 1.0}) == []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no xml",
        of_joint("fixed").replace("1 2 3", "1 2"),
        of_joint("fixed").replace("1 2 3", "1 2 nan"),
        of_joint("fixed").replace("1 2 3", "1 2 x"),
        of_joint("fixed").replace('<child link="b"/>', ""),
    ],
)
def test_what_is_no_robot_is_refused_in_words(text):
    with pytest.raises(ValueError, match="robot_description cannot be read"):
        Links(text)
