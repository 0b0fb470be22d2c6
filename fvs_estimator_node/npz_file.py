"""Reads and writes ``.npz`` files that strangers may have sent: no pickles, nothing oversized."""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

#: More elements than this in one array, or text longer than this in a sentence, is nothing of ours.
_MAX_ELEMENTS, _MAX_QUOTED = 2**27, 200


class NpzFile:
    """The checked content of one file.

    Every problem raises the error class given, with one sentence that names the path, what was
    wrong and what was expected.

    Parameters
    ----------
    path : path-like
        The file.
    kind : str
        What ``format`` must say.
    version : int
        What ``version`` must say.
    max_bytes : int
        Largest uncompressed size.
    error : type
        A subclass of ValueError.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: str,
        version: int,
        max_bytes: int,
        error: type[ValueError],
    ) -> None:
        self.path = Path(path)
        self._error = error
        self._arrays = self._read(max_bytes)
        found = self.text("format")
        if found != kind:
            raise self.refusal(f"is of format {clipped(repr(found))}, expected {kind!r}")
        number = self._get("version")
        if number.shape != () or number.dtype.kind not in "iu":
            raise self.refusal("has a version that is not a whole number")
        if int(number) != version:
            raise self.refusal(
                f"has {kind} version {int(number)}, this program reads version {version}"
            )

    def refusal(self, what: str) -> ValueError:
        """An error to raise: the path and what is wrong with it."""
        return self._error(f"{self.path} {clipped(what, 4 * _MAX_QUOTED)}")

    def _read(self, max_bytes: int) -> dict[str, np.ndarray]:
        if self.path.is_dir():
            raise self.refusal("is a folder, expected a .npz file")
        try:
            with zipfile.ZipFile(self.path) as archive:
                members = archive.infolist()
                total = sum(member.file_size for member in members)
                if total > max_bytes:
                    raise self.refusal(
                        f"holds {total / 2**20:.0f} MB, expected at most {max_bytes / 2**20:.0f} MB"
                    )
                return {
                    member.filename.removesuffix(".npy"): self._read_array(archive, member)
                    for member in members
                }
        except FileNotFoundError:
            raise self.refusal("does not exist") from None
        except OSError as exception:
            raise self.refusal(f"cannot be read: {exception.strerror or exception}") from None
        except self._error:
            raise
        except (
            zipfile.BadZipFile,
            ValueError,
            EOFError,
            NotImplementedError,
            RuntimeError,
            MemoryError,
        ) as exception:
            reason = str(exception) or type(exception).__name__
            raise self.refusal(f"is not a readable .npz file ({reason})") from None
        except Exception as exception:  # zlib and lzma errors have no common base
            raise self.refusal(f"is not a readable .npz file ({exception})") from None

    def _read_array(self, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
        with archive.open(member) as stream:
            major, _ = np.lib.format.read_magic(stream)
            header = (
                np.lib.format.read_array_header_1_0
                if major == 1
                else np.lib.format.read_array_header_2_0
            )
            shape, _, dtype = header(stream)
        if dtype.hasobject or dtype.kind not in "biufU":
            raise self.refusal(f"holds {member.filename} of type {dtype}, expected numbers or text")
        count = int(np.prod(shape, dtype=object))
        # Texts of no length take no room, however many.
        if (
            count > _MAX_ELEMENTS
            or dtype.itemsize == 0
            or count * dtype.itemsize > member.file_size
        ):
            raise self.refusal(f"holds {member.filename} that claims to be larger than it is")
        with archive.open(member) as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)

    def has(self, name: str) -> bool:
        """Whether there is a field of this name."""
        return name in self._arrays

    def _get(self, name: str) -> np.ndarray:
        try:
            return self._arrays[name]
        except KeyError:
            found = ", ".join(sorted(self._arrays)[:12]) or "nothing"
            raise self.refusal(f"lacks the field {name!r}; it holds {found}") from None

    def text(self, name: str) -> str:
        """A text field."""
        value = self._get(name)
        if value.shape != () or value.dtype.kind != "U":
            raise self.refusal(f"has a field {name!r} that is not a text")
        return self._strings(name, value)[0]

    def texts(self, name: str) -> tuple[str, ...]:
        """A list of texts."""
        value = self._get(name)
        if value.ndim != 1 or value.dtype.kind != "U":
            raise self.refusal(f"has a field {name!r} that is not a list of texts")
        return self._strings(name, value)

    def _strings(self, name: str, value: np.ndarray) -> tuple[str, ...]:
        try:
            return tuple(str(element) for element in value.reshape(-1))
        except (SystemError, ValueError):  # code points that there are not
            raise self.refusal(f"has a field {name!r} with characters that do not exist") from None

    def json(self, name: str) -> dict[str, Any]:
        """A text field that holds a JSON object."""
        try:
            value = json.loads(self.text(name))
        except (ValueError, RecursionError):  # no JSON, numbers without end, brackets without end
            value = None
        if not isinstance(value, dict):
            raise self.refusal(f"has a field {name!r} that is not a JSON object")
        return value

    def numbers(self, name: str, shape: Sequence[int | None], kinds: str = "iuf") -> np.ndarray:
        """An array of finite numbers.

        Parameters
        ----------
        name : str
            Field.
        shape : sequence
            Expected shape; None stands for any length.
        kinds : str
            Allowed kinds of dtype.
        """
        value = self._get(name)
        if value.dtype.kind not in kinds:
            raise self.refusal(f"has a field {name!r} of type {value.dtype}, expected numbers")
        if value.ndim != len(shape) or any(
            wanted is not None and got != wanted
            for got, wanted in zip(value.shape, shape, strict=True)
        ):
            words = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            raise self.refusal(f"has a field {name!r} of shape {value.shape}, expected {words}")
        if not np.all(np.isfinite(value)):
            raise self.refusal(f"has a field {name!r} with numbers that are not finite")
        if value.dtype.kind == "u" and value.size and int(value.max()) > np.iinfo(np.int64).max:
            raise self.refusal(f"has a field {name!r} with numbers beyond 64 bits with a sign")
        return value.astype(float) if value.dtype.kind == "f" else value

    def joint_names(self) -> tuple[str, ...]:
        """The field ``joint_names``: different texts."""
        names = self.texts("joint_names")
        if not names or len(set(names)) != len(names):
            raise self.refusal(f"names the joints {list(names)}, expected different names")
        return names


def clipped(text: str, length: int = _MAX_QUOTED) -> str:
    """A text of another program's file, at most of this length."""
    return text if len(text) <= length else f"{text[:length]}…"


def check_same(
    error: type[ValueError],
    what: str,
    joint_names: Sequence[str],
    feature_frame: str,
    expected_joint_names: Sequence[str] | None,
    expected_feature_frame: str | None,
) -> None:
    """Refuse other joints, another joint order, or another feature frame than expected."""
    if expected_joint_names is not None and tuple(joint_names) != tuple(expected_joint_names):
        raise error(
            f"{what} has the joint order {clipped(str(list(joint_names)))}, expected "
            f"{list(expected_joint_names)}"
        )
    if expected_feature_frame is not None and feature_frame != expected_feature_frame:
        raise error(
            f"{what} has ball positions in the frame {clipped(repr(feature_frame))}, expected "
            f"{expected_feature_frame!r}"
        )


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write a file in one piece: either the old one or the whole new one is there.

    Parameters
    ----------
    path : path-like
        The file; its folder must exist.
    arrays : mapping
        Fields; no objects.
    """
    target = Path(path)
    handle, temporary = tempfile.mkstemp(
        prefix=f".{target.name}.", suffix=".tmp", dir=target.parent or Path(".")
    )
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, **arrays)
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
