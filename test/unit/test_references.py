"""The file of taught references: what is kept, what is read, what is refused."""

import numpy as np
import pytest
from cases import each

from fvs_controller_node.references import Reference, References
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector

POSE, JOINTS = Pose(), ("base", "elbow")
Z = POSE.of_body(np.array([0.01, -0.2, 0.3]), rotation_from_vector(np.array([0.1, 2.0, -1.0])))


def test_what_is_kept_is_read_again_beside_others_and_keeps_the_speed_that_was_edited(tmp_path):
    path = tmp_path / "kitchen" / "references.yaml"
    references = References(path, POSE, JOINTS)
    references.keep("grasp", Reference(Z, "object", deviation_m=1e-4))
    references.keep("retreat", Reference(Z, "camera"))
    text = path.read_text()
    assert text.count("speed: 1.0") == 2
    edited = path.with_name("edited.yaml")
    edited.write_text(text.replace("speed: 1.0", "speed: 2e-1") + "7: {}\n")
    path.unlink()
    path.symlink_to(edited)
    references.keep("grasp", Reference(Z, "object"))
    grasp, retreat = references.get("grasp"), references.get("retreat")
    np.testing.assert_allclose(grasp.z, Z, atol=1e-12)
    assert (grasp.frame, grasp.speed, retreat.frame) == ("object", 0.2, "camera")
    assert path.is_symlink()
    assert sorted(path.parent.iterdir()) == [edited, path]


def test_a_file_from_before_it_told_its_origin_is_read(tmp_path):
    path = tmp_path / "references.yaml"
    path.write_text("grasp: {feature: ball, frame: object, x: 1e-3, y: 0, z: -0.1}")
    np.testing.assert_array_equal(References(path, Ball(), JOINTS).get("grasp").z, [1e-3, 0, -0.1])
    with pytest.raises(ValueError, match="it is of mount fixed, expected arm"):
        References(path, Ball(camera_mount="arm"), JOINTS).get("grasp")


def test_no_file_is_written_or_read_that_is_too_large_for_the_controller(tmp_path):
    path = tmp_path / "references.yaml"
    references = References(path, POSE, JOINTS)
    path.write_text("grasp: {}\n".ljust(2**16, "#"))
    references.keep("grasp", Reference(Z, "object"))  # without the comment
    path.write_text("other: " + "x" * (2**16 - 100))
    with pytest.raises(ValueError, match="would be larger than 64 kB"):
        references.keep("grasp", Reference(Z, "object"))
    path.write_text("#" * (2**16 + 1))
    with pytest.raises(ValueError, match="it is larger than 64 kB"):
        references.get("grasp")


@each(
    ("damage", "why"),
    [
        (("grasp:", "graps:"), "did you mean graps"),
        (("x: 0.01", "x: left"), "x is left, expected a number"),
        (("x: 0.01", "x: .nan"), "x is nan, expected a number"),
        (("  x: 0.01\n", ""), "x is None, expected a number"),
        (("feature: pose", "feature: ball"), "it is of feature ball, expected pose"),
        (("speed: 1.0", "speed: 2.0"), "speed is 2, expected more than 0, up to 1"),
        (("  qw:", "  qq:"), "unknown entry 'qq'"),
        (("speed: 1.0", "spead: 0.1"), "unknown entry 'spead'; did you mean speed"),
        (("speed: 1.0", "speed: fast"), "speed is fast, expected a number"),
        (("frame: object", "frame: 3"), "frame is missing"),
        (("version: 1", "version: 2"), "it is of version 2, expected 1"),
        (("[base, elbow]", "[base]"), r"of joints \['base'\], expected \['base', 'elbow'\]"),
        (("mount: fixed", "mount: arm"), "it is of mount arm, expected fixed"),
        (("  x: 0.01\n", "  x: 1" + "0" * 400 + "\n"), "x is 10+, expected a number"),
        (("grasp:", "- grasp:"), "expected names of references"),
    ],
)
def test_a_damaged_file_is_refused_with_what_is_wrong(damage, why, tmp_path):
    path = tmp_path / "references.yaml"
    path.unlink(missing_ok=True)
    references = References(path, POSE, JOINTS)
    references.keep("grasp", Reference(Z, "object"))
    path.write_text(path.read_text().replace(*damage))
    with pytest.raises(ValueError, match=why):
        references.get("grasp")


def test_what_is_no_speed_is_not_replaced_by_the_full_one(tmp_path):
    path = tmp_path / "references.yaml"
    path.write_text("grasp: {speed: slow}")
    with pytest.raises(ValueError, match="speed is slow"):
        References(path, POSE, JOINTS).keep("grasp", Reference(Z, "object"))


def test_a_damaged_file_is_not_overwritten(tmp_path):
    path = tmp_path / "references.yaml"
    path.write_text("[1, 2")
    with pytest.raises(ValueError, match="cannot be read"):
        References(path, POSE, JOINTS).keep("grasp", Reference(Z, "object"))
    assert path.read_text() == "[1, 2"


@each("path", ["~nobody-is-called-so/r.yaml", "no\0name", ""])
def test_a_path_that_cannot_be_is_refused(path):
    with pytest.raises(ValueError, match=r"none|null|directory"):
        References(path, POSE, JOINTS).get("grasp")
