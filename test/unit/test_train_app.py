"""What `fvs_train` prints, writes and refuses."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import Recording, relative_error

from fvs_estimator_node.files import load_data_set, load_model, save_data_set
from fvs_tools.train import main

RECORDING = Recording(seconds=15.0, late_s=0.05, outliers=0.0)


@pytest.fixture
def data_file(tmp_path):
    save_data_set(tmp_path / "data.npz", RECORDING.data())
    return tmp_path / "data.npz"


def test_a_chain_teaches_the_networks(data_file, tmp_path, capsys):
    model = tmp_path / "model.npz"
    arguments = [str(data_file), "-o", str(model), "--method", "poe", "--neurons", "30"]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    for words in (
        "Jacobian of the chain, in the box of the data: 0.",
        "off the chain (median)",
        "images stamped late: ",
        "note: the images show the joints of 50 ms before their stamps",
        "model written",
    ):
        assert words in printed
    trained = load_model(model)
    assert trained.model.widths.shape == (6, 30)
    assert trained.provenance["method"] == "poe"
    joints = RECORDING.sampled_joints()
    true = RECORDING.chain().jacobian(joints)
    assert np.median(relative_error(trained.chain.jacobian(joints), true)) < 0.01
    assert np.median(relative_error(trained.model.jacobian(joints), true)) < 0.05
    assert 0.0 < trained.errors["jacobian_deviation"] < 0.005
    assert 0.0 < trained.errors["distillation_error"] < 0.05
    first = model.read_bytes()
    assert main([*arguments, "--quiet", "--backend", "threading"]) == 0
    assert (
        capsys.readouterr().out == f"model written to {model}; use it with -p model_path:={model}\n"
    )
    assert model.read_bytes() == first


def first_20(path):
    """The data set, cut in place."""
    data = load_data_set(path)
    names = ("stamps_s", "joints_rad", "z", "segment")
    save_data_set(path, replace(data, **{name: getattr(data, name)[:20] for name in names}))
    return path


def slow(path):
    """The data set, its images too far apart."""
    data = load_data_set(path)
    segment = np.arange(len(data))
    save_data_set(path, replace(data, stamps_s=1.0 * segment, segment=segment))
    return path


@pytest.mark.parametrize(
    ("data_of", "options", "words"),
    [
        (lambda path: path.parent / "no.npz", (), "does not exist"),
        (lambda path: path, ("--neurons", "0"), "neurons must"),
        (lambda path: path, ("--method", "poe", "--neurons", "0"), "neurons must"),
        (lambda path: path, ("-o", "/proc/no/model.npz"), "cannot be written"),
        (first_20, (), "expected at least"),
        (first_20, ("--method", "poe"), "at least 200 images"),
        (slow, ("--method", "poe"), "images came at 1.0 Hz, at least 4 are needed"),
        (lambda path: path, ("--backend", "nowhere"), "Invalid backend: nowhere"),
        (lambda path: path, ("--backend", "loky,2"), "expected NAME,key=value"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(data_file, capsys, data_of, options, words):
    model = data_file.parent / "model.npz"
    assert main([str(data_of(data_file)), "-o", str(model), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("fvs_train: ")
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert not model.exists()
