"""Data sets and models: what is written comes back; anything else is refused in one sentence."""

import os
from dataclasses import replace

import numpy as np
import pytest
from cases import each
from recordings import ur5_chain

from fvs_estimator_node.files import (
    DataSet,
    FileError,
    TrainedModel,
    load_data_set,
    load_model,
    range_of,
    save_data_set,
    save_model,
)
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.chain import CHAIN_SHAPES
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds import KindConfig
from fvs_ros.kinds.pose import Pose


def some_data(n=8, names=("a", "b", "c")):
    rng = np.random.default_rng(0)
    joints, ball = rng.normal(size=(n, len(names))), rng.normal(size=(n, 3))
    provenance = {"robot": "none", "seed": 3}
    return DataSet(np.arange(n) / 30.0, joints, ball, np.arange(n) // 4, names, "lens", provenance)


def some_model():
    rng = np.random.default_rng(0)
    return TrainedModel(
        RbfModel(rng.normal(size=(6, 4, 6)), np.ones((6, 4)), rng.normal(size=(6, 3, 4))),
        np.array([[-1.0] * 6, [1.0] * 6]),
        rng.normal(size=(5, 3)),
        UR_JOINT_NAMES,
        errors={"pair_error_relative": 0.01},
        provenance={"method": "ridge"},
        chain=ur5_chain(),
    )


FILES = {
    "data set": (save_data_set, load_data_set, some_data, "stamps_s", "joints_rad"),
    "model": (save_model, load_model, some_model, "widths", "centres"),
}


@pytest.fixture(params=FILES)
def kind(request):
    return FILES[request.param]


@pytest.fixture
def written(kind, tmp_path):
    path = tmp_path / "file.npz"
    kind[0](path, kind[2]())
    return path


def rewrite(path, **changes):
    with np.load(path) as content:
        fields = {name: content[name] for name in content.files}
    fields.update(changes)
    with path.open("wb") as stream:
        np.savez(stream, **{name: value for name, value in fields.items() if value is not None})


def refused(kind, path, words):
    with pytest.raises(FileError, match=words) as error:
        kind[1](path)
    assert str(path) in str(error.value)


def test_a_data_set_comes_back_as_it_was(tmp_path):
    data = some_data()
    save_data_set(tmp_path / "d.npz", data)
    back = load_data_set(tmp_path / "d.npz", joint_names=("a", "b", "c"))
    for name in ("stamps_s", "joints_rad", "z", "segment"):
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
    rewrite(tmp_path / "d.npz", z=None, ball_m=data.z)  # as it was called before
    np.testing.assert_array_equal(load_data_set(tmp_path / "d.npz").z, data.z)
    assert (back.joint_names, back.feature_frame) == (("a", "b", "c"), "lens")
    assert back.provenance == data.provenance
    assert [run.stop for run in back.runs()] == [4, 8]


@pytest.mark.parametrize("has_chain", [True, False])
def test_a_model_comes_back_as_it_was(tmp_path, has_chain):
    trained = some_model() if has_chain else replace(some_model(), chain=None)
    save_model(tmp_path / "m.npz", trained)
    back = load_model(tmp_path / "m.npz", expected=KindConfig())
    for name in ("centres", "widths", "weights"):
        np.testing.assert_array_equal(getattr(back.model, name), getattr(trained.model, name))
    for name in ("joint_box_rad", "z_samples"):
        np.testing.assert_array_equal(getattr(back, name), getattr(trained, name))
    assert (back.errors, back.provenance) == (trained.errors, trained.provenance)
    assert (back.chain is not None) == has_chain
    for name in CHAIN_SHAPES if has_chain else ():
        wanted = getattr(ur5_chain(), name)
        np.testing.assert_allclose(getattr(back.chain, name), wanted, rtol=0.0, atol=1e-15)


def test_fields_that_are_not_as_declared_are_refused(kind, written):
    whole = written.read_bytes()
    with np.load(written) as content:
        infinite = content[kind[4]].copy()
    infinite.flat[3] = np.inf
    for changes, words in (
        ({"version": np.array(99)}, "version 99, this program reads version 1"),
        ({"format": np.array("fvs_other")}, "is of format 'fvs_other', expected 'fvs_"),
        ({kind[3]: None}, f"lacks the field '{kind[3]}'"),
        ({kind[3]: np.zeros((3, 3, 3))}, f"{kind[3]} has shape"),
        ({kind[4]: np.array("text")}, f"{kind[4]} holds something that is not a number"),
        ({kind[4]: infinite}, f"{kind[4]} holds a number that is not finite"),
        ({"joint_names": np.array(["a", "a"])}, "expected different names"),
        ({"joint_names": np.array(["a", "b"])}, "has shape|do not fit together"),
        ({"provenance": np.array("[1]")}, "not a JSON object"),
    ):
        written.write_bytes(whole)
        rewrite(written, **changes)
        refused(kind, written, words)


ZERO_AXIS = ur5_chain().axes.copy()
ZERO_AXIS[2] = 0.0


@each(
    ("name", "changes", "words"),
    [
        ("data set", {"stamps_s": -np.arange(8.0)}, "do not rise"),
        ("data set", {"segment": np.arange(8)[::-1]}, "go back"),
        ("model", {"widths": -np.ones((6, 4))}, "widths must be positive"),
        ("model", {"joint_box_rad": np.array([[1.0] * 6, [-1.0] * 6])}, "least value above"),
        ("model", {"chain_feature_m": None}, "lacks the field 'chain_feature_m'"),
        ("model", {"chain_axes": ZERO_AXIS}, "an axis of a chain has no direction"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, name, changes, words):
    kind, path = FILES[name], tmp_path / "x.npz"
    kind[0](path, kind[2]())
    rewrite(path, **changes)
    refused(kind, path, words)


def test_pickles_are_not_opened(kind, written, tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "trapped"),))

    rewrite(written, **{kind[4]: np.array([Trap()], dtype=object)})
    refused(kind, written, "expected numbers or text")
    assert not (tmp_path / "trapped").exists()


def test_writing_is_all_or_nothing(kind, written, monkeypatch):
    before = written.read_bytes()

    def fail(*_args, **_fields):
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        kind[0](written, kind[2]())
    assert written.read_bytes() == before
    assert os.listdir(written.parent) == [written.name]


def test_a_pose_is_read_as_a_pose_and_not_as_a_ball(tmp_path):
    rng, pose, of = np.random.default_rng(1), Pose(), {"feature": "pose", "feature_frame": "lens"}
    chain = replace(ur5_chain(), feature_m=pose.of_body(rng.normal(size=3), np.eye(3)))
    joints = rng.normal(size=(12, 6))
    seen = chain.position(joints)
    networks = RbfModel(rng.normal(size=(6, 4, 6)), np.ones((6, 4)), rng.normal(size=(6, 12, 4)))
    trained_on = range_of(joints, seen, rng)
    save_data_set(tmp_path / "d.npz", DataSet(np.arange(12.0), joints, seen, np.zeros(12), **of))
    model = TrainedModel(networks, **trained_on, joint_names=UR_JOINT_NAMES, chain=chain, **of)
    save_model(tmp_path / "m.npz", model)
    wanted = KindConfig("lens", "pose")
    data = load_data_set(tmp_path / "d.npz", expected=wanted)
    np.testing.assert_array_equal(data.z, seen)
    back = load_model(tmp_path / "m.npz", expected=wanted)
    np.testing.assert_allclose(back.chain.position(joints), seen)
    with pytest.raises(FileError, match="made for feature pose, expected ball"):
        load_model(tmp_path / "m.npz", expected=KindConfig("lens"))
    rewrite(tmp_path / "d.npz", z=2.0 * seen)
    with pytest.raises(FileError, match="is no pose"):
        load_data_set(tmp_path / "d.npz")
