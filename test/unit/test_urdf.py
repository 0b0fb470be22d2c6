"""A URDF is read as people save it, and only the arm's own joints matter."""

import pytest
import yaml

from fvs_ros.limits import URDF_LIMITS, with_urdf_limits
from fvs_ros.params import ParameterError
from fvs_ros.paths import find_file
from fvs_ros.urdf import moving_chain, read_joints
from fvs_tools.kinematics import kinematics

TEXT = find_file("robots/ur5.urdf").read_text("utf-8")
JOINTS = read_joints(TEXT)
_DECLARED = '<?xml version="1.0"?>'


def declared(encoding):
    return TEXT.replace(_DECLARED, f'<?xml version="1.0" encoding="{encoding}"?><!-- Kraft: ä -->')


AS_SAVED = {
    "an unbound prefix": TEXT.replace("</robot>", "<gazebo><s:camera n='1'/></gazebo></robot>"),
    "a default namespace": TEXT.replace("<robot ", '<robot xmlns="http://example.org" '),
    "ros2 param get": f"String value is: {TEXT}",
    "ros2 topic echo": yaml.safe_dump({"data": TEXT}, width=10**9, default_style='"') + "---\n",
    "ros2 topic echo, beyond ASCII": yaml.safe_dump({"data": declared("utf-8")}, width=10**9),
    "ros2 topic echo --field data": f"{TEXT}---\n",
    "a parameter file": yaml.safe_dump({"n": {"robot_description": TEXT}}, default_style="|"),
    "UTF-16": declared("utf-16").encode("utf-16"),
    "Latin-1": declared("iso-8859-1").encode("latin-1"),
    "Latin-1 that says nothing": TEXT.replace("<robot ", "<!-- ä --><robot ").encode("latin-1"),
    "DOCTYPE in a comment": TEXT.replace("<robot ", "<!-- no <!DOCTYPE a> --><robot "),
}


@pytest.mark.parametrize("how", AS_SAVED)
def test_a_urdf_is_read_as_people_save_it(how):
    assert read_joints(AS_SAVED[how]) == JOINTS


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot><xacro:include filename='a.xacro'/></robot>", "a xacro, .*`ros2 run xacro"),
        (TEXT.replace('name="elbow_joint"', 'name="${prefix}elbow_joint"'), "a xacro"),
        (f"<!DOCTYPE robot [<!ENTITY a 'b'>]>{TEXT.partition('?>')[2]}", "DOCTYPE"),
        (
            f"<?a <!-- ?><!DOCTYPE robot [<!ENTITY a 'b'>]><!-- -->{TEXT.partition('?>')[2]}",
            "DOCTYPE",
        ),
        (yaml.safe_dump({"data": f"{TEXT[:128]}..."}, width=10**9), "--full-length"),
        (TEXT[: len(TEXT) // 2], "cut off"),
        ("<sdf version='1.7'/>", "got <sdf>"),
        ("", "no XML"),
        (TEXT.replace('<child link="forearm_link"/>', ""), "elbow_joint' of the URDF lacks a link"),
    ],
)
def test_what_is_no_urdf_is_named(text, words):
    with pytest.raises(ValueError, match=words):
        read_joints(text)


VALUES = {"tf_prefix": "", "joint_names": list(JOINTS)[:6], **dict.fromkeys(URDF_LIMITS, ())}
LIMITS = with_urdf_limits(VALUES, JOINTS)


def joint(name, parent, child, kind="revolute", inside=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside or '<limit lower=' + repr('-1') + ' upper=' + repr('1') + '/>'}</joint>"
    )


def and_(text, *more):
    return read_joints(text.replace("</robot>", f"{''.join(more)}</robot>"))


def test_only_the_arms_own_joints_matter():
    odd = {
        "limits": joint("odd", "base_link", "pan", inside="<limit lower='1' upper='-1'/>"),
        "a bad number": joint("odd", "base_link", "pan", inside="<limit lower='a'/>"),
    }
    for words, text in odd.items():
        joints = and_(TEXT, text)
        assert words in joints["odd"].problem
        assert with_urdf_limits(VALUES, joints) == LIMITS
        assert len(kinematics(joints).names) == 6
    assert with_urdf_limits(VALUES, and_("<robot></robot>", joint("a", "b", "c"))) == VALUES
    assert with_urdf_limits(VALUES, {}) == VALUES


@pytest.mark.parametrize("number", ["9", "nan", "x"])
def test_a_bad_joint_of_the_arm_is_named_unless_all_limits_are_given(number):
    joints = read_joints(TEXT.replace('lower="-3.14159', f'lower="{number}" was="', 1))
    with pytest.raises(ParameterError, match="joint 'elbow_joint' of the URDF has"):
        with_urdf_limits(VALUES, joints)
    with pytest.raises(ValueError, match="joint 'elbow_joint' of the URDF has"):
        kinematics(joints)
    values = {**VALUES, **dict.fromkeys(URDF_LIMITS, (1.0,) * 6)}
    assert {name: with_urdf_limits(values, joints)[name] for name in values} == values


def test_the_default_tip_is_the_arms_last_link_and_no_finger():
    hand = (
        joint("hand_joint", "mount", "hand", "fixed"),
        joint("left_joint", "hand", "left", "fixed"),
        joint("finger_1", "left", "lf", "prismatic"),
        joint("finger_2", "hand", "rf", "prismatic"),
    )
    tip, moving = moving_chain(and_(TEXT.replace("tool0", "mount"), *hand))
    assert tip == "wrist_3_link"
    assert [moved.name for moved in moving] == VALUES["joint_names"]
    assert moving_chain(and_(TEXT.replace("tool0", "flange"), *hand))[0] == "flange"


def test_a_urdf_of_joints_in_a_ring_ends():
    ring = and_("<robot></robot>", joint("a", "l1", "l2"), joint("b", "l2", "l1"))
    assert len(kinematics(ring, "l1").names) == 2
    with pytest.raises(ValueError, match="no joints: is it a xacro"):
        kinematics(read_joints('<robot name="r"/>'))
