"""Reads and writes the ``.npz`` files of this package: no pickles, nothing oversized."""

from __future__ import annotations

import json
import os
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

#: More elements than this in one array is nothing of ours.
_MAX_ELEMENTS = 2**27
#: Longest quotation of a file's content in an error.
_MAX_QUOTED = 200
_VERSION = 1


class FileError(ValueError):
    """A file that cannot be used; one sentence with its path, what is wrong, what was expected."""


class NpzFile:
    """The content of one file of any origin, checked for its kind, size, joints and frame.

    ``joint_names`` and ``feature_frame`` of None take any. Raises FileError if it is none, or not
    as expected.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: str,
        max_bytes: int,
        joint_names: Sequence[str] | None,
        feature_frame: str | None,
    ) -> None:
        self.path = Path(path)
        self._arrays = self._read(max_bytes)
        found = self.text("format")
        if found != kind:
            raise self.refusal(f"is of format {_clipped(repr(found))}, expected {kind!r}")
        version = self.array("version").tolist()
        if version != _VERSION:
            raise self.refusal(
                f"has {kind} version {_clipped(repr(version))}, this program reads version "
                f"{_VERSION}"
            )
        names, frame = self.texts("joint_names"), self.text("feature_frame")
        if not names or len(set(names)) != len(names):
            raise self.refusal(f"names the joints {list(names)}, expected different names")
        if joint_names is not None and names != tuple(joint_names):
            raise self.refusal(
                f"has the joint order {_clipped(str(list(names)))}, expected {list(joint_names)}"
            )
        if feature_frame is not None and frame != feature_frame:
            raise self.refusal(
                f"has ball positions in the frame {_clipped(repr(frame))}, expected "
                f"{feature_frame!r}"
            )

    def refusal(self, what: str) -> FileError:
        """An error to raise: the path and what is wrong with it."""
        return FileError(f"{self.path} {_clipped(what, 4 * _MAX_QUOTED)}")

    def _read(self, max_bytes: int) -> dict[str, np.ndarray]:
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
        except FileError:
            raise
        except FileNotFoundError:
            raise self.refusal("does not exist") from None
        except OSError as exception:
            raise self.refusal(f"cannot be read: {exception.strerror or exception}") from None
        except Exception as exception:  # those of zipfile, zlib, lzma and numpy have no common base
            reason = str(exception) or type(exception).__name__
            raise self.refusal(f"is not a readable .npz file ({reason})") from None

    def _read_array(self, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
        with archive.open(member) as stream:
            first = np.lib.format.read_magic(stream) == (1, 0)
            form = np.lib.format
            header = form.read_array_header_1_0 if first else form.read_array_header_2_0
            shape, _, dtype = header(stream)
        if dtype.hasobject or dtype.kind not in "biufU":
            raise self.refusal(f"holds {member.filename} of type {dtype}, expected numbers or text")
        count = int(np.prod(shape, dtype=object))
        # Texts of no length take no room, however many.
        size = count * dtype.itemsize
        if count > _MAX_ELEMENTS or dtype.itemsize == 0 or size > member.file_size:
            raise self.refusal(f"holds {member.filename} that claims to be larger than it is")
        with archive.open(member) as stream:
            array = np.lib.format.read_array(stream, allow_pickle=False)
        if dtype.kind == "U":
            codes = np.frombuffer(array.tobytes(), np.dtype("u4").newbyteorder(dtype.byteorder))
            if codes.max(initial=0) > sys.maxunicode:
                raise self.refusal(f"holds {member.filename} with characters that do not exist")
        return array

    def has(self, name: str) -> bool:
        """Whether there is a field of this name."""
        return name in self._arrays

    def array(self, name: str) -> np.ndarray:
        """A field of any type and shape."""
        if name not in self._arrays:
            found = ", ".join(sorted(self._arrays)[:12]) or "nothing"
            raise self.refusal(f"lacks the field {name!r}; it holds {found}")
        return self._arrays[name]

    def texts(self, name: str, dimensions: int = 1) -> tuple[str, ...]:
        """A list of texts, or of a single one without dimensions."""
        value = self.array(name)
        if value.ndim != dimensions or value.dtype.kind != "U":
            raise self.refusal(f"has a field {name!r} that is not a text or a list of texts")
        return tuple(str(element) for element in value.reshape(-1))

    def text(self, name: str) -> str:
        """A text."""
        return self.texts(name, 0)[0]

    def json(self, name: str) -> dict[str, Any]:
        """A text that holds a JSON object."""
        try:
            value = json.loads(self.text(name))
        except FileError:
            raise
        except (ValueError, RecursionError):  # no JSON, numbers without end, brackets without end
            value = None
        if not isinstance(value, dict):
            raise self.refusal(f"has a field {name!r} that is not a JSON object")
        return value


def _clipped(text: str, length: int = _MAX_QUOTED) -> str:
    return text if len(text) <= length else f"{text[:length]}…"


def write_npz(path: str | os.PathLike[str], kind: str, fields: Mapping[str, Any]) -> None:
    """Write a file in one piece: either the old one or the whole new one is there.

    Parameters
    ----------
    path : path-like
        The file; its folder must exist.
    kind : str
        Its format.
    fields : mapping
        Arrays, texts, and mappings that JSON can hold.
    """
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
