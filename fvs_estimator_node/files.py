"""Data sets and trained models, and their ``.npz`` files: no pickles, nothing oversized."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from fvs_estimator_node.rbf import RbfModel
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import CHAIN_SHAPES, SerialChain
from fvs_ros.kinds import KINDS, Kind, KindConfig
from fvs_ros.kinds.kind import FIXED, MOUNTS, ON_ARM, UNNAMED
from fvs_ros.pixel_chain import PixelChain, PixelChains, Webcam
from fvs_ros.timeline import Sample
from fvs_ros.vectors import check_arrays
from fvs_ros.view import ViewConfig

_VERSION = 1
#: Two hours at 200 Hz stay below this; a larger file is refused.
_MAX_BYTES = 2**28
#: Longest error sentence and names quoted in it, most notes of a model and longest of them: a file
#: may hold anything.
_LONGEST_ERROR, _LONGEST_QUOTE, _MOST_NOTES, _LONGEST_NOTE = 800, 300, 20, 500
#: Measurements of the training that a model keeps.
_Z_SAMPLES = 500

_DATA_SET = {"stamps_s": ("k",), "joints_rad": ("k", "n"), "z": ("k", "m"), "segment": ("k",)}
_MODEL: dict[str, tuple[int | str, ...]] = {
    "joint_box_rad": (2, "n"),
    "z_samples": ("k", "m"),
}
_NETWORKS = ("centres", "widths", "weights")
_CHAIN = {f"chain_{name}": name for name in CHAIN_SHAPES}
#: What older files lack, as it was then.
_OLDER = {"feature": KindConfig.feature, "camera_mount": FIXED, "cameras": (UNNAMED,)}


class FileError(ValueError):
    """A file that cannot be used; one sentence with its path, what is wrong, what was expected."""


@dataclass(frozen=True, kw_only=True)
class _OfFeature:
    """What was measured: the name of a kind of feature, its frame, by which cameras, and where."""

    feature: str = KindConfig.feature  #: its kind
    camera_mount: str = KindConfig.camera_mount
    feature_frame: str = CAMERA_FRAME  #: that of the measurements
    cameras: tuple[str, ...] = (UNNAMED,)
    #: Count of the numbers that all cameras measure at once.
    _count: ClassVar[Any]

    @property
    def kind(self) -> Kind:
        """The kind of feature, with the usual parameters; a ``ValueError`` if m is not its own."""
        count = self._count
        kind = KINDS[self.feature].of_numbers(count, self.camera_mount, self.cameras)
        if count != kind.numbers:
            raise ValueError(f"a {kind.name} has {kind.numbers} numbers, got {count}")
        return kind

    def _check_numbers(self, measured: np.ndarray) -> None:
        """A ``ValueError`` if measurements, (k, m), are none of the kind."""
        for z in measured[:1]:
            if not self.kind.fits(z):
                raise ValueError(f"{np.round(z, 3).tolist()} is no {self.kind.name}")

    def check(self, expected: KindConfig | None) -> None:
        """A ``ValueError`` if another kind, frame or camera was expected; None takes any."""
        if expected is None:
            return
        frame, right = self.feature_frame, expected.feature_frame
        if frame != right:
            raise ValueError(f"positions in the frame {frame!r}, expected {right!r}")
        made_for, right = _words(self.kind), _words(expected.kind)
        if made_for != right:
            raise ValueError(f"made for feature {made_for}, expected {right}")


def _words(kind: Kind) -> str:
    words = f"{kind.name} ({kind.numbers} numbers), camera_mount {kind.camera_mount}"
    cameras = ", ".join(kind.cameras) or "one without a name"
    return words if kind.rigid else f"{words}, cameras: {cameras}"


@dataclass(frozen=True)
class DataSet(_OfFeature):
    """k measurements and the joints at their exposures.

    A ``ValueError`` says that shapes do not fit, something is not finite, or stamps, segments or
    cameras go back.
    """

    stamps_s: np.ndarray  #: exposure times, s, (k,); rising within a segment
    joints_rad: np.ndarray  #: joint positions at exposure, rad, (k, n)
    #: Measurements of the kind, such as ball positions, m, (k, m); each of one camera.
    z: np.ndarray
    segment: np.ndarray  #: number of the continuous run a sample belongs to, (k,); never falls
    joint_names: tuple[str, ...] = ()  #: of the columns; by default ``joint_1``, ``joint_2``, ...
    #: Where it comes from; anything that JSON can hold.
    provenance: Mapping[str, Any] = field(default_factory=dict)
    still: bool = False  #: whether the arm stood still at every image: still poses
    camera: np.ndarray | int = 0  #: which of ``cameras`` a sample is of, (k,); never falls

    def __post_init__(self) -> None:
        n = check_arrays(self, _DATA_SET)["n"]
        self._check_numbers(self.z)
        names = tuple(self.joint_names) or tuple(f"joint_{i + 1}" for i in range(n))
        if len(names) != n:
            raise ValueError(f"{len(names)} joint names and {n} joints do not fit together")
        object.__setattr__(self, "joint_names", names)
        with np.errstate(invalid="ignore"):
            object.__setattr__(self, "segment", self.segment.astype(np.int64))
        if np.any(np.diff(self.segment) < 0):
            raise ValueError("segment numbers go back, expected runs one after the other")
        same = np.diff(self.segment) == 0
        if np.any(np.diff(self.stamps_s)[same] <= 0.0):
            raise ValueError("stamps_s do not rise within a segment")
        if np.ndim(self.camera):
            check_arrays(self, {"camera": ("k",)}, k=len(self))
        camera, count = np.broadcast_to(self.camera, len(self)), len(self.cameras)
        known = np.isin(camera, range(count)).all()
        if not known or np.any(np.diff(camera) < 0) or np.any(np.diff(camera)[same]):
            raise ValueError(
                f"camera is not a number below {count} that never falls and is the same in a "
                "segment"
            )
        object.__setattr__(self, "camera", camera.astype(np.int64) if count > 1 else 0)

    def __len__(self) -> int:
        return len(self.stamps_s)

    @property
    def _count(self) -> int:
        return self.z.shape[1] * len(self.cameras)

    @property
    def parts(self) -> tuple[DataSet, ...]:
        """The samples of each camera."""
        parts = []
        for number, name in enumerate(self.cameras):
            chosen = np.broadcast_to(self.camera, len(self)) == number
            mine = {field: getattr(self, field)[chosen] for field in _DATA_SET}
            parts.append(replace(self, **mine, camera=0, cameras=(name,)))
        return tuple(parts)

    def runs(self) -> list[slice]:
        """The continuous runs, one after the other."""
        ends = [0, *(np.flatnonzero(np.diff(self.segment)) + 1).tolist(), len(self)]
        return [slice(a, b) for a, b in pairwise(ends)]


def data_set_of(*of_camera: Sequence[Sample], **particulars: Any) -> DataSet:
    """A data set of the samples of each camera; ``particulars`` are its other fields."""
    samples = [sample for samples in of_camera for sample in samples]
    stamps_s, joints_rad, z, run = (np.array(column) for column in zip(*samples, strict=True))
    camera = np.repeat(np.arange(len(of_camera)), [len(samples) for samples in of_camera])
    segment = run + camera * (run.max() + 1)
    return DataSet(stamps_s, joints_rad, z, segment, camera=camera, **particulars)


@dataclass(frozen=True)
class TrainedModel(_OfFeature):
    """The networks, with the data needed to use them; a ``ValueError`` if they do not fit."""

    model: RbfModel
    #: Least and greatest joint positions trained on, rad, (2, n); outside, networks extrapolate.
    joint_box_rad: np.ndarray
    z_samples: np.ndarray  #: some measurements trained on, (k, m): the arm can reach them
    joint_names: tuple[str, ...]  #: the joint order
    errors: Mapping[str, Any] = field(default_factory=dict)  #: figures of the training by name
    #: Where it comes from; anything that JSON can hold.
    provenance: Mapping[str, Any] = field(default_factory=dict)
    #: Fitted to the same data, for the method ``poe``; before webcams, one for each.
    chain: SerialChain | PixelChains | None = None

    def __post_init__(self) -> None:
        n, m = self.model.weights.shape[:2]
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        joints = n if self.chain is None else self.chain.joints
        if not len(self.joint_names) == n == joints:
            raise ValueError(
                f"{len(self.joint_names)} joint names, networks of {n} and a chain of {joints} "
                "joints do not fit together"
            )
        check_arrays(self, _MODEL, n=n)
        self._check_numbers(self.z_samples)
        if self.chain is not None and self.chain.numbers != self.kind.numbers:
            raise ValueError(f"a chain of {self.chain.numbers} numbers is for no {self.kind.name}")
        learned = len(self.kind.learned)
        if m != learned:
            raise ValueError(f"networks of {m} numbers, expected {learned}")
        low, high = self.joint_box_rad
        if np.any(low > high):
            raise ValueError("joint_box_rad has a least value above the greatest")

    @property
    def _count(self) -> int:
        return self.z_samples.shape[1]

    def target(self, z: np.ndarray, distance_m: float, rng: np.random.Generator) -> np.ndarray:
        """A measurement trained on, (m,), that is about a distance, m, away from z.

        With the camera on the arm, one that the controller takes to be in view.
        """
        kind, view, samples = self.kind, ViewConfig(), self.z_samples
        if kind.on_arm:
            samples = np.array([row for row in samples if not view.out_of_view(kind, row)])
        if not len(samples):
            raise ValueError("nothing that was trained on is in view")
        apart_m = np.linalg.norm((samples - z) * kind.weights, axis=1)
        mismatch_m = np.abs(apart_m - distance_m)
        # Those within 20 mm are equally good.
        fitting = np.flatnonzero(mismatch_m <= max(0.02, mismatch_m.min()))
        return np.asarray(samples[rng.choice(fitting)])

    def seen_by(self, cameras: tuple[str, ...]) -> TrainedModel:
        """The same for some of its cameras, in this order."""
        chosen, chain = [self.cameras.index(name) for name in cameras], self.chain
        rows = np.arange(self.kind.numbers).reshape(len(self.cameras), -1)[chosen].ravel()
        if isinstance(chain, PixelChains):
            chain = PixelChains(tuple(chain.each[number] for number in chosen))
        return replace(
            self,
            model=replace(self.model, weights=self.model.weights[:, rows]),
            z_samples=self.z_samples[:, rows],
            chain=chain,
            cameras=cameras,
        )

    def figures(self, camera: str) -> dict[str, Any]:
        """The error figures of a camera; if it is not the only one, its name is before theirs."""
        before = f"{camera}/"
        if not any(name.startswith(before) for name in self.errors):
            before = ""
        own = {name: value for name, value in self.errors.items() if name.startswith(before)}
        return {name.removeprefix(before): value for name, value in own.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What the training found that a user of the model should know, a sentence each."""
        notes = self.provenance.get("notes", ())
        if not isinstance(notes, (list, tuple)):
            return ()
        return tuple(" ".join(str(note).split())[:_LONGEST_NOTE] for note in notes[:_MOST_NOTES])


def range_of(joints_rad: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """A model's fields on what it was trained on: joints, rad, (k, n), and measurements, (k, m)."""
    return {
        "joint_box_rad": np.stack([joints_rad.min(axis=0), joints_rad.max(axis=0)]),
        "z_samples": z[rng.permutation(len(z))[:_Z_SAMPLES]],
    }


# ---- writing and reading --------------------------------------------------------------------


def save_data_set(path: str | os.PathLike[str], data: DataSet) -> None:
    """Write a data set in one piece."""
    _write(path, "fvs_dataset", vars(data))


def save_model(path: str | os.PathLike[str], trained: TrainedModel) -> None:
    """Write a model in one piece."""
    fields = {**vars(trained), **vars(trained.model)}
    del fields["model"]
    chain = fields.pop("chain")
    arms = [] if chain is None else [chain]
    if isinstance(chain, PixelChains):
        fields["webcam"] = np.concatenate([each.webcam.numbers for each in chain.each])
        arms = [each.chain for each in chain.each]
    for stored, name in _CHAIN.items() if arms else ():
        fields[stored] = np.concatenate([getattr(arm, name) for arm in arms])
    _write(path, "fvs_rbf_model", fields)


def load_data_set(path: str | os.PathLike[str]) -> DataSet:
    """Read and check a data set; a :class:`FileError` says what is not as expected."""
    with _content(path, "fvs_dataset") as content:
        return DataSet(
            **{name: content[name] for name in _DATA_SET},
            **content.common,
            camera=content.get("camera", 0),
            provenance=content.json("provenance"),
            still="still" in content and bool(content["still"].any()),
        )


def load_model(
    path: str | os.PathLike[str],
    joint_names: Sequence[str] | None = None,
    expected: KindConfig | None = None,
) -> TrainedModel:
    """Read and check a model; a :class:`FileError` says what is not as expected.

    Joint order, kind of feature and frame may be expected; None takes any. Of a model of several
    cameras those that are expected are taken.
    """
    with _content(path, "fvs_rbf_model", joint_names) as content:
        trained = TrainedModel(
            RbfModel(*(content[name] for name in _NETWORKS)),
            **{name: content[name] for name in _MODEL},
            **content.common,
            errors=content.json("errors"),
            provenance=content.json("provenance"),
            chain=content.chain() if any(name in content for name in _CHAIN) else None,
        )
        cameras = trained.cameras if expected is None else expected.kind.cameras
        if cameras != trained.cameras and set(cameras) <= set(trained.cameras):
            trained = trained.seen_by(cameras)
        trained.check(expected)
        return trained


def _write(path: str | os.PathLike[str], kind: str, fields: Mapping[str, Any]) -> None:
    """Write arrays, texts and JSON atomically."""
    target = Path(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    arrays: dict[str, Any] = {
        name: json.dumps(dict(value), sort_keys=True) if isinstance(value, Mapping) else value
        for name, value in {"format": kind, "version": _VERSION, **fields}.items()
    }
    try:
        with temporary.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def _content(
    path: str | os.PathLike[str], kind: str, joint_names: Sequence[str] | None = None
) -> Iterator[_Content]:
    """A file's content, its format and joints checked; what goes wrong is a FileError."""
    try:
        content = _Content(_arrays(Path(path)))
        content.check(kind, joint_names)
        yield content
        return
    except FileNotFoundError:
        words = "does not exist"
    except OSError as error:
        words = f"cannot be read: {error.strerror or error}"
    except ValueError as error:
        words = str(error)
    raise FileError(f"{path}: {words[:_LONGEST_ERROR]}")


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file by name, without trust in its headers."""
    with path.open("rb") as file:
        if file.read(4) != b"PK\x03\x04":  # np.load would advise to trust it as a pickle
            raise ValueError("is no .npz file")
    try:
        with np.load(path, allow_pickle=False) as arrays:
            total = sum(member.file_size for member in arrays.zip.infolist())
            if total <= _MAX_BYTES:
                return {name: _number_or_text(name, arrays[name]) for name in arrays.files}
    except OSError:
        raise
    except Exception as error:  # those of zipfile, zlib, lzma and numpy have no common base
        reason = str(error) or type(error).__name__
        raise ValueError(f"not a readable .npz file ({reason})") from None
    raise ValueError(f"holds {total >> 20} MB, expected at most {_MAX_BYTES >> 20} MB")


def _number_or_text(name: str, value: Any) -> np.ndarray:
    array = np.asarray(value)  # of a member that is no array: its bytes
    if array.dtype.kind not in "biufU":
        raise ValueError(f"{name} is of type {array.dtype}, expected numbers or text")
    if array.dtype.kind == "U":
        code = np.dtype(np.uint32).newbyteorder(array.dtype.byteorder)
        letters = np.frombuffer(array.tobytes(), code)
        if letters.size and letters.max() > sys.maxunicode:  # no text, and reading it fails
            raise ValueError(f"{name} holds characters that are none")
    if not array.itemsize:  # any number of them would take no bytes here, and hours as a list
        raise ValueError(f"{name} holds texts without characters")
    return array


class _Content(dict[str, Any]):
    """The arrays of a file, with checks in words (ValueError)."""

    def __missing__(self, name: str) -> Any:
        fields = ", ".join(sorted(self)[:12]) or "nothing"
        raise ValueError(f"lacks the field {name!r}; it holds {fields}")

    def check(self, kind: str, joint_names: Sequence[str] | None) -> None:
        """Check format, version and joints; None takes any."""
        if self.text("format") != kind:
            raise ValueError(f"is of format {self.text('format')!r}, expected {kind!r}")
        version = self["version"].tolist()
        if version != _VERSION:
            raise ValueError(f"{kind} version {version!r}, this program reads version {_VERSION}")
        names = self.texts("joint_names")
        quoted = str(list(names))[:_LONGEST_QUOTE]
        if not names or len(set(names)) != len(names):
            raise ValueError(f"names the joints {quoted}, expected different names")
        if joint_names is not None and names != tuple(joint_names):
            raise ValueError(f"joint order {quoted}, expected {list(joint_names)}")
        for name, value in _OLDER.items():
            self.setdefault(name, np.array(value))
        self.common: dict[str, Any] = {"joint_names": names, "cameras": self.texts("cameras")}
        if not self.common["cameras"]:
            raise ValueError("names no camera, expected one or more")
        known = {"feature": KINDS, "camera_mount": MOUNTS, "feature_frame": ()}
        for name, choices in known.items():
            text = self.common[name] = self.text(name)
            if choices and text not in choices:
                raise ValueError(f"made for {name} {text!r}, expected {', '.join(choices)}")

    def chain(self) -> SerialChain | PixelChains:
        """The chain, or those before each webcam, one after the other in every array."""
        count, names = len(self.common["cameras"]), self.common["joint_names"]
        self.setdefault("chain_lens", np.zeros(2))  # older files lack these
        self.setdefault("chain_play_rad", np.zeros(len(names)))
        for stored in _CHAIN:
            if len(np.atleast_1d(self[stored])) % count:
                raise ValueError(f"{stored} has not as many rows for each of {count} cameras")
        blocks = [np.split(np.atleast_1d(self[stored]), count) for stored in _CHAIN]
        on_arm = self.common["camera_mount"] == ON_ARM
        arms = [
            SerialChain(**dict(zip(_CHAIN.values(), block, strict=True)), on_arm=on_arm)
            for block in zip(*blocks, strict=True)
        ]
        if KINDS[self.common["feature"]].rigid:
            return arms[0]
        lenses = SimpleNamespace(webcam=self["webcam"])
        check_arrays(lenses, {"webcam": (6 * count,)})
        webcams = map(Webcam.of_numbers, np.split(lenses.webcam, count))
        return PixelChains(tuple(map(PixelChain, arms, webcams)))

    def texts(self, name: str, dimensions: int = 1) -> tuple[str, ...]:
        """A list of texts, or a single one without dimensions."""
        value = self[name]
        if value.ndim != dimensions or value.dtype.kind != "U":
            raise ValueError(f"has a field {name!r} that is not a text or a list of texts")
        return tuple(value.reshape(-1).tolist())

    def text(self, name: str) -> str:
        """A text."""
        return self.texts(name, 0)[0]

    def json(self, name: str) -> dict[str, Any]:
        """A text that holds a JSON object."""
        text = self.text(name)
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):  # no JSON, numbers without end, brackets without end
            value = None
        if not isinstance(value, dict):
            raise ValueError(f"has a field {name!r} that is not a JSON object")
        return value
