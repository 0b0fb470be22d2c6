import os
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from recordings import ur5_chain

from fvs_estimator_node.dataset import DataSet, DataSetError, load_data_set, save_data_set
from fvs_estimator_node.model_file import (
    ModelFileError,
    TrainedModel,
    load_model,
    save_model,
)
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.chain import chain_shapes
from fvs_ros.joints import UR_JOINT_NAMES, UR_PUBLISHED_NAMES


def some_data(n=8):
    rng = np.random.default_rng(0)
    return DataSet(
        np.arange(n) / 30.0,
        rng.normal(size=(n, 6)),
        rng.normal(size=(n, 3)),
        np.arange(n) // 4,
        provenance={"robot": "none", "seed": 3},
    )


def some_model():
    rng = np.random.default_rng(0)
    return TrainedModel(
        RbfModel(rng.normal(size=(6, 4, 6)), np.ones((6, 4)), rng.normal(size=(6, 3, 4))),
        np.array([[-1.0] * 6, [1.0] * 6]),
        np.array([[-1.0] * 3, [1.0] * 3]),
        rng.normal(size=(5, 3)),
        errors={"pair_error_relative": 0.01},
        provenance={"method": "ridge"},
    )


KINDS = {
    "data set": (save_data_set, load_data_set, some_data, DataSetError, "stamps_s", "joints_rad"),
    "model": (save_model, load_model, some_model, ModelFileError, "widths", "centres"),
}


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


@pytest.fixture
def written(kind, tmp_path):
    path = tmp_path / "file.npz"
    kind[0](path, kind[2]())
    return path


def rewrite(path, **changes):
    with np.load(path) as content:
        fields = {name: content[name] for name in content.files}
    for name, value in changes.items():
        if value is None:
            del fields[name]
        else:
            fields[name] = value
    with path.open("wb") as stream:
        np.savez(stream, **fields)


def refused(kind, path, words, **options):
    with pytest.raises(kind[3], match=words) as caught:
        kind[1](path, **options)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text.strip()


def test_a_data_set_comes_back_as_it_was(tmp_path):
    data = some_data()
    save_data_set(tmp_path / "d.npz", data)
    back = load_data_set(tmp_path / "d.npz")
    for name in ("stamps_s", "joints_rad", "ball_m", "segment"):
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
    assert back.joint_names == UR_JOINT_NAMES
    assert back.provenance == data.provenance
    assert len(back) == 8


def test_a_model_comes_back_as_it_was(tmp_path):
    trained = some_model()
    save_model(tmp_path / "m.npz", trained)
    back = load_model(tmp_path / "m.npz", feature_frame="camera_color_optical_frame")
    for name in ("centres", "widths", "weights"):
        np.testing.assert_array_equal(getattr(back.model, name), getattr(trained.model, name))
    for name in ("joint_box_rad", "ball_box_m", "ball_samples_m"):
        np.testing.assert_array_equal(getattr(back, name), getattr(trained, name))
    assert (back.errors, back.provenance) == (trained.errors, trained.provenance)


def with_a_chain():
    return replace(some_model(), chain=ur5_chain())


def test_a_model_with_a_chain_comes_back_with_it(tmp_path):
    assert load_saved(tmp_path, some_model()).chain is None
    chain = load_saved(tmp_path, with_a_chain()).chain
    for name in chain_shapes(6):
        np.testing.assert_allclose(
            getattr(chain, name), getattr(ur5_chain(), name), rtol=0.0, atol=1e-15
        )


def load_saved(folder, trained):
    save_model(folder / "m.npz", trained)
    return load_model(folder / "m.npz")


def test_a_chain_that_cannot_be_one_is_refused(tmp_path):
    path = tmp_path / "m.npz"
    zero_axis, far = ur5_chain().axes.copy(), ur5_chain().points_m.copy()
    zero_axis[2] = 0.0
    far[0, 0] = 1e6
    for name in chain_shapes(6):
        save_model(path, with_a_chain())
        rewrite(path, **{f"chain_{name}": None})
        refused(KINDS["model"], path, f"lacks the field 'chain_{name}'")
    for changes, words in (
        ({"chain_axes": np.ones((5, 3))}, "'chain_axes' of shape"),
        ({"chain_ball_m": np.array("far")}, "'chain_ball_m' of type"),
        ({"chain_reference_rad": np.full(6, np.nan)}, "not finite"),
        ({"chain_axes": zero_axis}, "an axis of a chain has no direction"),
        ({"chain_points_m": far}, "points_m of a chain must be finite and below 100"),
    ):
        save_model(path, with_a_chain())
        rewrite(path, **changes)
        refused(KINDS["model"], path, words)


def test_a_missing_file_a_folder_and_other_files(kind, tmp_path):
    refused(kind, tmp_path / "none.npz", "does not exist")
    refused(kind, tmp_path, "is a folder")
    other = tmp_path / "text.npz"
    other.write_text("hello")
    refused(kind, other, r"not a readable \.npz")
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    refused(kind, tmp_path / "zip.npz", r"not a readable \.npz")


def test_the_other_format_and_another_version(kind, written):
    rewrite(written, version=np.array(99))
    refused(kind, written, "version 99, this program reads version 1")
    rewrite(written, version=np.array("1"))
    refused(kind, written, "version that is not a whole number")
    rewrite(written, format=np.array("fvs_other"))
    refused(kind, written, "is of format 'fvs_other', expected 'fvs_")


def test_a_missing_field_a_wrong_shape_a_wrong_type(kind, written):
    whole = written.read_bytes()
    for changes, words in (
        ({kind[4]: None}, f"lacks the field '{kind[4]}'"),
        ({kind[4]: np.zeros((3, 3, 3))}, f"'{kind[4]}' of shape"),
        ({kind[5]: np.zeros((2, 5))}, f"'{kind[5]}' of shape"),
        ({kind[5]: np.array("text")}, f"'{kind[5]}' of type"),
        ({"joint_names": np.array(["a", "b"])}, "has the joint order"),
        ({"provenance": np.array("{")}, "not a JSON object"),
        ({"provenance": np.array("[1]")}, "not a JSON object"),
        ({"feature_frame": np.array(3)}, "'feature_frame' that is not a text"),
    ):
        written.write_bytes(whole)
        rewrite(written, **changes)
        refused(kind, written, words)


def test_a_number_that_is_not_finite(kind, written):
    with np.load(written) as content:
        value = content[kind[5]].copy()
    value.flat[3] = np.nan
    rewrite(written, **{kind[5]: value})
    refused(kind, written, "not finite")


def test_pickles_are_not_opened(kind, written, tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "trapped"),))

    rewrite(written, **{kind[5]: np.array([Trap()], dtype=object)})
    refused(kind, written, "expected numbers or text")
    assert not (tmp_path / "trapped").exists()


def test_another_joint_order_and_another_frame(kind, written):
    refused(kind, written, "joint order", joint_names=UR_PUBLISHED_NAMES)
    refused(kind, written, "expected 'base'", feature_frame="base")
    kind[1](written, joint_names=None, feature_frame=None)


def test_stamps_and_segments_that_go_back(tmp_path):
    data = some_data()
    for changes, words in (
        ({"stamps_s": data.stamps_s[::-1]}, "do not rise"),
        ({"segment": data.segment[::-1]}, "go back"),
    ):
        save_data_set(tmp_path / "d.npz", data)
        rewrite(tmp_path / "d.npz", **changes)
        refused(KINDS["data set"], tmp_path / "d.npz", words)


def test_bad_networks_and_boxes(tmp_path):
    for changes, words in (
        ({"widths": -np.ones((6, 4))}, "widths must be positive"),
        ({"joint_box_rad": np.array([[1.0] * 6, [-1.0] * 6])}, "least value above"),
    ):
        save_model(tmp_path / "m.npz", some_model())
        rewrite(tmp_path / "m.npz", **changes)
        refused(KINDS["model"], tmp_path / "m.npz", words)


def test_writing_is_all_or_nothing(kind, written, monkeypatch):
    before = written.read_bytes()

    def fail(*_args, **_fields):
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        kind[0](written, kind[2]())
    assert written.read_bytes() == before
    assert os.listdir(written.parent) == [written.name]


def test_equal_content_makes_equal_files(kind, tmp_path):
    kind[0](tmp_path / "a.npz", kind[2]())
    kind[0](tmp_path / "b.npz", kind[2]())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
