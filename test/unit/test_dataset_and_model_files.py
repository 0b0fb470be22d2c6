"""Data sets and models: what is written comes back; anything else is refused in one sentence."""

import io
import os
import resource
import subprocess
import sys
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import each
from hypothesis import given
from hypothesis import strategies as st
from recordings import ur5_chain
from strangers import FEW, unless_refused

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
from fvs_ros.pixel_chain import PixelChain, PixelChains, Webcam


def some_data(n=8, names=("a", "b", "c")):
    rng = np.random.default_rng(0)
    joints, ball = rng.normal(size=(n, len(names))), rng.normal(size=(n, 3))
    provenance = {"robot": "none", "seed": 3}
    of = {"feature_frame": "lens", "provenance": provenance}
    return DataSet(np.arange(n) / 30.0, joints, ball, np.arange(n) // 4, names, **of)


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


def some_webcams():
    rng, chain = np.random.default_rng(0), ur5_chain()
    each = (PixelChain(chain, Webcam(focal_px, (320.0, 240.0))) for focal_px in (500.0, 600.0))
    model = some_model()
    return replace(
        model,
        model=replace(model.model, weights=rng.normal(size=(6, 4, 4))),
        z_samples=rng.normal(size=(5, 4)),
        chain=PixelChains(tuple(each)),
        feature="points",
        cameras=("front", "side"),
    )


FILES = {
    "data set": (save_data_set, load_data_set, some_data),
    "model": (save_model, load_model, some_model),
    "webcams": (save_model, load_model, some_webcams),
}


ROOT = Path(__file__).resolve().parents[2]


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
    back = load_data_set(tmp_path / "d.npz")
    for name in ("stamps_s", "joints_rad", "z", "segment"):
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
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


ZERO_AXIS = ur5_chain().axes.copy()
ZERO_AXIS[2] = 0.0
#: What is no data set or model: which it is made of, what is changed, and what is said.
WRONG = [
    ("data set", {"stamps_s": None}, "lacks the field 'stamps_s'"),
    ("data set", {"stamps_s": -np.arange(8.0)}, "do not rise"),
    ("data set", {"segment": np.arange(8)[::-1]}, "go back"),
    ("data set", {"camera": np.arange(8)}, "camera is not a number below 1"),
    ("data set", {"cameras": np.array(["a", "b"])}, "a ball is seen by one camera"),
    ("data set", {"cameras": np.array(3)}, "a field 'cameras' that is not a text or a list"),
    ("data set", {"joints_rad": np.full((8, 3), np.inf)}, "joints_rad holds a number that is not"),
    ("data set", {"joints_rad": np.array("text")}, "joints_rad holds something that is not a num"),
    ("data set", {"joint_names": np.array(["a", "b"])}, "has shape|do not fit together"),
    ("model", {"version": np.array(99)}, "version 99, this program reads version 1"),
    ("model", {"format": np.array("fvs_other")}, "is of format 'fvs_other', expected 'fvs_"),
    ("model", {"widths": np.zeros((3, 3, 3))}, "widths has shape"),
    ("model", {"widths": -np.ones((6, 4))}, "widths must be positive"),
    ("model", {"joint_names": np.array(["a"] * 999)}, "expected different names"),
    ("model", {"provenance": np.array("[1]")}, "not a JSON object"),
    ("model", {"joint_box_rad": np.array([[1.0] * 6, [-1.0] * 6])}, "least value above"),
    ("model", {"chain_feature_m": None}, "lacks the field 'chain_feature_m'"),
    ("webcams", {"cameras": np.array(["front", "front"])}, "different names"),
    ("webcams", {"cameras": np.array(["a", "b", "c"])}, "not as many rows for each of 3 cameras"),
    ("webcams", {"webcam": np.array(["1"] * 11 + ["a"])}, "webcam holds something that is not"),
    ("webcams", {"webcam": None}, "lacks the field 'webcam'"),
    ("webcams", {"webcam": np.ones(7)}, r"webcam has shape \(7,\), expected \(12\)"),
    ("webcams", {"chain_axes": np.ones((13, 3))}, "chain_axes has not as many rows"),
    ("model", {"chain_axes": ZERO_AXIS}, "an axis of a chain has no direction"),
]


@each(("name", "changes", "words"), WRONG)
def test_what_cannot_be_is_refused(tmp_path, name, changes, words):
    kind, path = FILES[name], tmp_path / "x.npz"
    kind[0](path, kind[2]())
    rewrite(path, **changes)
    refused(kind, path, words)


def test_other_files_are_refused_without_advice_to_trust_them(kind, tmp_path):
    path = tmp_path / "x.npz"
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    for content in (b"", b"some text", array.getvalue()):
        path.write_bytes(content)
        refused(kind, path, "x.npz: is no .npz file$")


def test_pickles_are_not_opened(kind, written, tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "trapped"),))

    rewrite(written, joint_names=np.array([Trap()], dtype=object))
    refused(kind, written, "Object arrays cannot be loaded")
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
    wanted = KindConfig("lens", feature="pose")
    data = load_data_set(tmp_path / "d.npz")
    data.check(wanted)
    np.testing.assert_array_equal(data.z, seen)
    back = load_model(tmp_path / "m.npz", expected=wanted)
    np.testing.assert_allclose(back.chain.position(joints), seen)
    for expected in (KindConfig("lens"), KindConfig("lens", camera_mount="arm", feature="pose")):
        right = f"{expected.feature} .*, camera_mount {expected.camera_mount}"
        with pytest.raises(FileError, match=f"pose .*, camera_mount fixed, expected {right}"):
            load_model(tmp_path / "m.npz", expected=expected)
    rewrite(tmp_path / "d.npz", z=2.0 * seen)
    with pytest.raises(FileError, match="is no pose"):
        load_data_set(tmp_path / "d.npz")


# ---- files from strangers ---------------------------------------------------------------------

DESCRS = ("<f8", ">f8", "<f4", "<f2", "<i8", "|b1", "<c16", "<U1", "|S3", "|O", "<M8[s]", "|V8")


def pack(members):
    """Write members, (name, bytes) pairs, into an archive; names may be doubled."""
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # of doubled names
        for name, content in members:
            archive.writestr(name, content)
    return stream.getvalue()


def claim(descr, shape, content=b""):
    """An array file whose header says anything."""
    stream = io.BytesIO()
    header = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + content


@FEW
@given(
    cut=st.floats(0.0, 2.0),
    flips=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 255)), max_size=12),
    tail=st.binary(max_size=30),
)
def test_bytes_that_were_cut_flipped_or_added(kind, written, tmp_path, cut, flips, tail):
    content = bytearray(written.read_bytes())
    for at, flip in flips:
        content[int(at * (len(content) - 1))] ^= flip
    content = bytes(content[: int(cut * len(content))]) + tail
    unless_refused(kind[1], tmp_path / "other.npz", content)


def odd_member(data):
    """Another array, or none, in place of the bytes of an old one."""
    content = data.draw(st.binary(max_size=400))
    if data.draw(st.booleans()):
        return content
    sides = st.integers(-3, 8) | st.sampled_from([2**31, 2**40, 2**62])
    shape = tuple(data.draw(st.lists(sides, max_size=3)))
    return claim(data.draw(st.sampled_from(DESCRS)), shape, content)


@FEW
@given(data=st.data())
def test_members_of_any_type_shape_and_content(kind, written, tmp_path, data):
    with zipfile.ZipFile(written) as archive:
        fields = {name: archive.read(name) for name in archive.namelist()}
    members = dict(fields)
    for _ in range(data.draw(st.integers(1, 3))):
        name = data.draw(st.sampled_from(sorted(fields)))
        if data.draw(st.booleans()):
            members[name] = odd_member(data)
        else:
            members.pop(name, None)
    twice = list(members.items())[: data.draw(st.integers(0, 1))]
    content = pack([*members.items(), *twice])
    used = unless_refused(kind[1], tmp_path / "other.npz", content)
    for value in vars(getattr(used, "model", used)).values() if used is not None else ():
        assert not isinstance(value, np.ndarray) or np.all(np.isfinite(value))


LOAD = """
import sys
from fvs_estimator_node.files import load_model
from fvs_tools.scenario import load_scenario
try:
    (load_model if sys.argv[1].endswith("npz") else load_scenario)(sys.argv[1])
except ValueError as error:
    print("refused", len(str(error)) < 5000)
"""


def endless_names():
    """A model of more joints than a list can take, whose names need no bytes."""
    yield "format.npy", claim("<U13", (), "fvs_rbf_model".encode("utf-32-le"))
    yield "version.npy", claim("<i8", (), (1).to_bytes(8, "little"))
    yield "joint_names.npy", claim("<U0", (10**9,))


def laughs(levels):
    lists = ["&a0 [x, x, x, x, x, x, x, x, x]"]
    lists += [f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    rows = "".join(f"    q{i}: {row}\n" for i, row in enumerate(lists))
    return f"/**:\n  ros__parameters:\n{rows}    seed: *a{levels - 1}\n".encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("bomb.npz", lambda: pack([("bomb.npy", claim("|u1", (2**28,), bytes(2**28)))])),
        ("texts.npz", lambda: pack(endless_names())),
        ("laughs.yaml", lambda: laughs(12)),
        ("sparse.yaml", None),  # 4 GB that take no room on the disk
    ],
)
def test_a_small_file_takes_neither_memory_nor_time(tmp_path, name, content):
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (1500 * 2**20,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (5, 5))

    path = tmp_path / name
    path.write_bytes(content() if content else b"")
    os.truncate(path, path.stat().st_size if content else 2**32)
    command = [sys.executable, "-c", LOAD, str(path)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, preexec_fn=limit, cwd=ROOT
    )
    assert done.stdout.strip() == "refused True", done.stderr
