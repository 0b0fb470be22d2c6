from dataclasses import replace

import numpy as np
import pytest
from recordings import Recording, relative_error

from fvs_estimator_node.files import DataSet, load_data_set, load_model, save_data_set
from fvs_tools.train import main


@pytest.fixture
def data_file(tmp_path):
    rng = np.random.default_rng(0)
    n = 600
    joints = rng.uniform(-0.5, 0.5, (n, 6))
    slope = rng.normal(size=(3, 6))
    slope[:, 5] = 0.0
    ball = joints @ slope.T + 0.1 * np.sin(joints[:, :3]) + 1e-3 * rng.standard_normal((n, 3))
    path = tmp_path / "data.npz"
    save_data_set(path, DataSet(np.arange(n) / 30.0, joints, ball, np.zeros(n, dtype=int)))
    return path


def test_a_chain_teaches_the_networks(tmp_path, capsys):
    data, model = tmp_path / "data.npz", tmp_path / "model.npz"
    recording = Recording(seconds=15.0, late_s=0.05, outliers=0.0)
    save_data_set(data, recording.data())
    arguments = [str(data), "-o", str(model), "--method", "poe", "--neurons", "30"]
    assert main(arguments) == 0
    captured = capsys.readouterr()
    assert "looking for the axes" in captured.err
    for words in (
        "Jacobian of the chain, in the box of the data: 0.",
        "off the chain (median)",
        "images stamped late: ",
        "note: the images show the joints of 50 ms before their stamps",
        "model written",
    ):
        assert words in captured.out
    trained = load_model(model)
    assert trained.model.neurons == 30
    assert trained.provenance["method"] == "poe"
    places = recording.places()
    true = recording.chain().jacobian(places)
    assert np.median(relative_error(trained.chain.jacobian(places), true)) < 0.01
    assert np.median(relative_error(trained.model.jacobian(places), true)) < 0.05
    assert 0.0 < trained.errors["jacobian_deviation"] < 0.005
    assert 0.0 < trained.errors["distillation_error"] < 0.05
    first = model.read_bytes()
    assert main([*arguments, "--quiet"]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"model written to {model}\n"
    assert captured.err.startswith("note: the images show the joints of 50 ms before")
    assert [f"note: {note}" for note in trained.notes] == captured.err.splitlines()
    assert model.read_bytes() == first


def changed(path, change):
    """A data set changed in place."""
    save_data_set(path, change(load_data_set(path)))
    return path


def first_20(data):
    names = ("stamps_s", "joints_rad", "z", "segment")
    return replace(data, **{name: getattr(data, name)[:20] for name in names})


@pytest.mark.parametrize(
    ("data_of", "options", "words"),
    [
        (lambda path: path.parent / "no.npz", (), "does not exist"),
        (lambda path: path, ("--neurons", "0"), "neurons must"),
        (lambda path: path, ("--method", "poe", "--neurons", "0"), "neurons must"),
        (lambda path: path, ("-o", "/nowhere/model.npz"), "folder"),
        (lambda path: changed(path, first_20), (), "expected at least"),
        (lambda path: changed(path, first_20), ("--method", "poe"), "at least 200 images"),
    ],
    ids=range(6),
)
def test_bad_input_is_one_sentence_and_code_2(data_file, capsys, data_of, options, words):
    model = data_file.parent / "model.npz"
    assert main([str(data_of(data_file)), "-o", str(model), *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("fvs_train: ")
    assert said.err.count("\n") == 1
    assert words in said.err
    assert not model.exists()
