"""Models, data sets and scenarios from strangers: used, or refused in words; nothing else."""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fvs_estimator_node.dataset import DataSet, load_data_set, save_data_set
from fvs_estimator_node.model_file import load_model
from fvs_estimator_node.npz_file import FileError
from fvs_tools.scenario import NODE_TABLE, load_scenario, params_yaml

ROOT = Path(__file__).resolve().parents[2]
FEW = settings(
    max_examples=120,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
DESCRS = ("<f8", ">f8", "<f4", "<f2", "<i8", "|b1", "<c16", "<U1", "|S3", "|O", "<M8[s]", "|V8")
NUMBERS = st.one_of(
    st.floats(-2.0, 2.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, -1.0])
)


@pytest.fixture(scope="module")
def data_set_bytes(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "data.npz"
    n = 12
    rng = np.random.default_rng(0)
    joints, ball = rng.normal(size=(n, 6)), rng.normal(size=(n, 3))
    save_data_set(path, DataSet(np.arange(n) / 30.0, joints, ball, np.arange(n) // 4))
    return path.read_bytes()


@pytest.fixture(scope="module")
def model_bytes():
    return (ROOT / "config/models/ur5_front.npz").read_bytes()


@pytest.fixture(params=["model", "data set"])
def kind(request, model_bytes, data_set_bytes):
    """What reads the file, the error it may raise, and a good file."""
    if request.param == "model":
        return load_model, FileError, model_bytes
    return load_data_set, FileError, data_set_bytes


def outcome(error, call, *arguments):
    """What the call answers, or None and the words of its refusal."""
    try:
        return call(*arguments), ""
    except error as refusal:
        return None, str(refusal)


def read(load, error, path):
    """Load; a refusal must name the file."""
    used, refusal = outcome(error, load, path)
    assert used is not None or str(path) in refusal
    return used


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


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


def claim(descr, shape, content=b""):
    """An array file whose header says anything."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue() + content


def change(content, **members):
    """The good file with other members in place of its own."""
    fields = fields_of(content)
    fields.update({f"{name}.npy": value for name, value in members.items()})
    return pack(fields.items())


@FEW
@given(
    cut=st.one_of(st.none(), st.floats(0.0, 1.0)),
    flips=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 255)), max_size=12),
    tail=st.binary(max_size=30),
)
def test_bytes_that_were_cut_flipped_or_added(kind, tmp_path, cut, flips, tail):
    load, error, good = kind
    content = bytearray(good)
    for place, flip in flips:
        content[int(place * (len(content) - 1))] ^= flip
    if cut is not None:
        content = content[: int(cut * len(content))]
    path = tmp_path / "file.npz"
    path.write_bytes(bytes(content) + tail)
    read(load, error, path)


@FEW
@given(data=st.data())
def test_members_of_any_type_shape_and_content(kind, tmp_path, data):
    load, error, good = kind
    fields = fields_of(good)
    members = list(fields.items())
    for _ in range(data.draw(st.integers(1, 3))):
        name = data.draw(st.sampled_from(sorted(fields)))
        what = data.draw(st.sampled_from(["numbers", "bytes", "header", "gone", "twice", "text"]))
        if what == "numbers":
            old = np.load(io.BytesIO(fields[name]))
            array = np.array(old, dtype=float if old.dtype.kind == "f" else old.dtype)
            if array.dtype.kind == "f" and array.size:
                array.flat[data.draw(st.integers(0, array.size - 1))] = data.draw(NUMBERS)
            members.append((name, npy(array)))
        elif what == "bytes":
            members.append((name, data.draw(st.binary(max_size=200))))
        elif what == "header":
            sides = st.one_of(st.integers(-3, 8), st.sampled_from([2**31, 2**40, 2**62]))
            shape = tuple(data.draw(st.lists(sides, max_size=3)))
            content = data.draw(st.binary(max_size=400))
            members.append((name, claim(data.draw(st.sampled_from(DESCRS)), shape, content)))
        elif what == "gone":
            members = [member for member in members if member[0] != name]
        elif what == "twice":
            members.append((name, fields[name]))
        else:
            members.append((name, npy(np.array(data.draw(st.text(max_size=20))))))
    path = tmp_path / "file.npz"
    path.write_bytes(pack(members))
    used = read(load, error, path)
    for value in vars(getattr(used, "model", used)).values() if used is not None else ():
        assert not isinstance(value, np.ndarray) or np.all(np.isfinite(value))


@pytest.mark.parametrize(
    "name", ["../../escaped.npy", "/tmp/escaped.npy", "a/b.npy", "C:\\x.npy", "x" * 60000]
)
def test_names_of_members_lead_nowhere(kind, tmp_path, name):
    load, error, good = kind
    folder = tmp_path / "deep" / "er"
    folder.mkdir(parents=True)
    path = folder / "file.npz"
    path.write_bytes(pack([*fields_of(good).items(), (name, npy(np.zeros(2)))]))
    read(load, error, path)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [path]


def in_a_small_process(code, *arguments, megabytes=1500, seconds=20):
    """Run a piece of Python with little memory and time; what it prints."""

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (megabytes * 2**20,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds,) * 2)

    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
        cwd=ROOT,
    )
    return done.stdout.strip() or done.stderr[-300:] or f"exit {done.returncode}"


LOAD_MODEL = """
import sys
from fvs_estimator_node.model_file import load_model
from fvs_estimator_node.npz_file import FileError
try:
    load_model(sys.argv[1])
except FileError as error:
    print("refused", len(str(error)))
"""


def test_a_small_file_that_unpacks_to_a_lot(model_bytes, tmp_path):
    path = tmp_path / "bomb.npz"
    path.write_bytes(change(model_bytes, bomb=claim("|u1", (2**28,), bytes(2**28))))
    assert path.stat().st_size < 2**20
    assert in_a_small_process(LOAD_MODEL, str(path)).startswith("refused")


def test_a_small_file_with_many_empty_texts(model_bytes, tmp_path):
    path = tmp_path / "many.npz"
    path.write_bytes(change(model_bytes, joint_names=claim("<U0", (2**33,))))
    assert in_a_small_process(LOAD_MODEL, str(path), seconds=5).startswith("refused")


@pytest.mark.parametrize("member", ["feature_frame", "version"])
def test_a_text_that_is_no_unicode(kind, tmp_path, member):
    load, error, good = kind
    path = tmp_path / "file.npz"
    path.write_bytes(change(good, **{member: claim("<U1", (), b"\xff" * 4)}))
    with pytest.raises(error, match=member):
        load(path)


def test_a_number_in_json_that_is_too_long(data_set_bytes, tmp_path):
    path = tmp_path / "file.npz"
    text = npy(np.array('{"a": ' + "1" * 5000 + "}"))
    path.write_bytes(change(data_set_bytes, provenance=text))
    with pytest.raises(FileError, match="provenance"):
        load_data_set(path)


@pytest.mark.parametrize("field", ["format", "feature_frame"])
def test_a_refusal_is_short_whatever_was_found(kind, tmp_path, field):
    load, error, good = kind
    path = tmp_path / "file.npz"
    path.write_bytes(change(good, **{field: npy(np.array("long" * 10000))}))
    with pytest.raises(error) as caught:
        load(path, feature_frame="camera_color_optical_frame")
    assert len(str(caught.value)) < 2000


# ---- scenarios ----------------------------------------------------------------------------------


def scenario(tmp_path, content):
    """Load a scenario of this text; a refusal must name the file."""
    path = tmp_path / "some.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    used, refusal = outcome(ValueError, load_scenario, str(path))
    assert used is not None or path.name in refusal
    return used


PLAIN = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**31), 2**31),
    st.floats(),
    st.text(max_size=20),
    st.dates(),
)
ANY_YAML = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(PLAIN, inner, max_size=4),
    max_leaves=12,
)


@FEW
@given(content=st.binary(max_size=300))
def test_any_bytes_are_a_scenario_or_refused(tmp_path, content):
    scenario(tmp_path, content)


@FEW
@given(content=ANY_YAML)
def test_any_yaml_is_a_scenario_or_refused(tmp_path, content):
    scenario(tmp_path, yaml.safe_dump(content))


@FEW
@given(data=st.data())
def test_any_value_of_any_parameter_is_checked(tmp_path, data):
    node = data.draw(st.sampled_from(sorted(NODE_TABLE)))
    names = sorted(parameter.name for parameter in NODE_TABLE[node].parameters())
    values = data.draw(st.dictionaries(st.sampled_from(names), ANY_YAML, max_size=3))
    content = {data.draw(st.sampled_from([node, "/**"])): {"ros__parameters": values}}
    content.setdefault(node, {"ros__parameters": {}})
    read_back = scenario(tmp_path, yaml.safe_dump(content))
    if read_back is not None:
        declared = NODE_TABLE[node].parameters()
        for name, value in read_back[node].items():
            assert declared[name].check(value) == value
        yaml.safe_load(params_yaml(read_back))


@FEW
@given(
    place=st.floats(0.0, 1.0),
    length=st.integers(0, 20),
    put=st.one_of(st.text("&*!|>{}[],:?-#%@`'\"\\\t\n\0<= aé", max_size=12), st.text(max_size=6)),
)
def test_a_good_scenario_with_something_put_in(tmp_path, place, length, put):
    good = (ROOT / "config/demo.yaml").read_text()
    at = int(place * len(good))
    text = good[:at] + put + good[at + length :]
    scenario(tmp_path, text.encode("utf-8", "surrogatepass"))


@pytest.mark.parametrize(
    "tag",
    [
        "!!python/object/apply:os.mkdir ['{}']",
        "!!python/object/new:os.mkdir ['{}']",
        "!!python/name:os.mkdir",
        "!!python/module:antigravity",
        "!!python/object:pathlib.Path {{}}",
    ],
)
def test_no_code_is_run(tmp_path, tag):
    trap = tmp_path / "trapped"
    value = tag.format(trap)
    assert scenario(tmp_path, f"fvs_sim_node: {{ros__parameters: {{seed: {value}}}}}") is None
    with pytest.raises(ValueError, match="law"):
        load_scenario("demo", [f"law:={value}"])
    assert not trap.exists()
    assert "antigravity" not in sys.modules


SEED = "fvs_sim_node: {{ros__parameters: {{seed: {}}}}}\n"


@pytest.mark.parametrize(
    "text",
    [
        b"\xff\xfe\x00\x01",
        b"\x80abc",
        SEED.format("2001-99-99"),
        SEED.format("!!set {a, b}"),
        SEED.format("&a [*a]"),
        SEED.format("1" * 5000),
        SEED.format(".nan"),
        "fvs_sim_node: {ros__parameters: {1: 2}}",
        "fvs_sim_node: {ros__parameters: {? [1, 2] : 2}}",
        "2001-01-01: {}",
        "&a [*a]",
        "*a",
        "%YAML 9.9\n---\n{}",
        "a: 1\n---\nb: 2\n",
    ],
)
def test_odd_scenarios_are_refused(tmp_path, text):
    assert scenario(tmp_path, text) is None


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("[" * 20000, id="deep list"),
        pytest.param("{a: " * 5000, id="deep mapping"),
        pytest.param(SEED.format("1" * 30), id="a whole number of 30 digits"),
        pytest.param(SEED.format("1:" * 2000 + "1"), id="a number to the base 60"),
        pytest.param(SEED.format("1" * 400), id="a whole number of 400 digits"),
        pytest.param(
            "fvs_sim_node: {ros__parameters: {latency_s: " + "1" * 400 + "}}",
            id="a number of 400 digits",
        ),
    ],
)
def test_deep_scenarios_and_long_numbers_are_refused(tmp_path, text):
    assert scenario(tmp_path, text) is None


def test_the_home_of_nobody_is_no_scenario():
    with pytest.raises(ValueError, match="nosuchuser"):
        load_scenario("~nosuchuser/x.yaml")


LOAD_SCENARIO = """
import sys
from fvs_tools.scenario import load_scenario
try:
    load_scenario(sys.argv[1])
except ValueError as error:
    print("refused", len(str(error)))
"""


def laughs(levels):
    lists = ["&a0 [x, x, x, x, x, x, x, x, x]"]
    lists += [f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    rows = "".join(f"    q{i}: {row}\n" for i, row in enumerate(lists))
    seed = f"fvs_sim_node:\n  ros__parameters:\n    seed: *a{levels - 1}\n"
    return f"/**:\n  ros__parameters:\n{rows}{seed}"


def merges(levels):
    rows = [f"a{i}: &a{i}\n  <<: [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, levels)]
    return "a0: &a0 {x: 1}\n" + "".join(rows)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(laughs(12), id="a billion laughs"),
        pytest.param(merges(12), id="a billion merges"),
    ],
)
def test_aliases_cannot_blow_up(tmp_path, text):
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    words = in_a_small_process(LOAD_SCENARIO, str(path), megabytes=1000, seconds=5).split()
    assert words[0] == "refused"
    assert int(words[1]) < 5000


def test_an_oversized_scenario_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "big.yaml"
    with path.open("wb") as stream:
        stream.truncate(2**32)  # sparse: it takes no room on the disk
    words = in_a_small_process(LOAD_SCENARIO, str(path), megabytes=1000, seconds=5)
    assert words.startswith("refused")
