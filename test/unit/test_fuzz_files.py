"""Models, data sets and scenarios from strangers: used, or refused in words; nothing else."""

import io
import os
import resource
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from cases import each
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fvs_estimator_node.files import DataSet, load_data_set, load_model, save_data_set
from fvs_tools.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[2]
FEW = settings(
    max_examples=60,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
DESCRS = ("<f8", ">f8", "<f4", "<f2", "<i8", "|b1", "<c16", "<U1", "|S3", "|O", "<M8[s]", "|V8")


@pytest.fixture(params=[load_model, load_data_set])
def kind(request, tmp_path):
    """What reads a file, and a good file."""
    path = ROOT / "config/models/ur5_front.npz"
    if request.param is load_data_set:
        path, rng = tmp_path / "good.npz", np.random.default_rng(0)
        joints, ball = rng.normal(size=(12, 6)), rng.normal(size=(12, 3))
        save_data_set(path, DataSet(np.arange(12) / 30.0, joints, ball, np.arange(12) // 4))
    return request.param, path.read_bytes()


def read(load, path, content):
    """Load a file of this content; None if it is refused, in words that name the file."""
    path.write_bytes(content)
    try:
        return load(path)
    except ValueError as refusal:
        words = str(refusal)
    assert path.name in words
    assert len(words) < 5000
    return None


def fields_of(content):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


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
def test_bytes_that_were_cut_flipped_or_added(kind, tmp_path, cut, flips, tail):
    load, good = kind
    content = bytearray(good)
    for at, flip in flips:
        content[int(at * (len(content) - 1))] ^= flip
    read(load, tmp_path / "file.npz", bytes(content[: int(cut * len(content))]) + tail)


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
def test_members_of_any_type_shape_and_content(kind, tmp_path, data):
    load, good = kind
    fields = fields_of(good)
    members = dict(fields)
    for _ in range(data.draw(st.integers(1, 3))):
        name = data.draw(st.sampled_from(sorted(fields)))
        if data.draw(st.booleans()):
            members[name] = odd_member(data)
        else:
            members.pop(name, None)
    twice = list(members.items())[: data.draw(st.integers(0, 1))]
    used = read(load, tmp_path / "file.npz", pack([*members.items(), *twice]))
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


def laughs(levels):
    lists = ["&a0 [x, x, x, x, x, x, x, x, x]"]
    lists += [f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    rows = "".join(f"    q{i}: {row}\n" for i, row in enumerate(lists))
    return f"/**:\n  ros__parameters:\n{rows}    seed: *a{levels - 1}\n".encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("bomb.npz", lambda: pack([("bomb.npy", claim("|u1", (2**28,), bytes(2**28)))])),
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


# ---- scenarios ----------------------------------------------------------------------------------


def scenario(tmp_path, content):
    content = content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
    return read(lambda path: load_scenario(str(path)), tmp_path / "some.yaml", content)


PLAIN = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**31), 2**31), st.floats(), st.text(max_size=20),
    st.dates(),
)  # fmt: skip
ANY_YAML = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(PLAIN, inner, max_size=4),
    max_leaves=12,
)


@FEW
@given(content=st.binary(max_size=300) | ANY_YAML.map(yaml.safe_dump))
def test_any_bytes_and_any_yaml_are_a_scenario_or_refused(tmp_path, content):
    scenario(tmp_path, content)


@pytest.mark.parametrize(
    "tag", ["!!python/object/apply:os.mkdir ['{}']", "!!python/module:antigravity"]
)
def test_no_code_is_run(tmp_path, tag):
    trap = tmp_path / "trapped"
    value = tag.format(trap)
    assert scenario(tmp_path, f"fvs_sim_node: {{ros__parameters: {{seed: {value}}}}}") is None
    with pytest.raises(ValueError, match="law"):
        load_scenario("demo", [f"law:={value}"])
    assert not trap.exists()
    assert "antigravity" not in sys.modules


@each("text", ["&a [*a]", "%YAML 9.9\n---\n{}", "a: 1\n---\nb: 2\n", "[" * 20000, "1" * 400])
def test_odd_scenarios_are_refused(tmp_path, text):
    assert scenario(tmp_path, text) is None
    assert scenario(tmp_path, f"fvs_sim_node: {{ros__parameters: {{seed: {text}}}}}\n") is None
