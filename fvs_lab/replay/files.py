"""The files of a bag: which there are, what they note, and what is whole of one that was cut off.

Where metadata are missing, the files themselves tell. An MCAP file is a chain of records; one
without an end (the recorder was killed, or the machine lost its power) is read from its beginning,
as far as its records are whole.
"""

from __future__ import annotations

import contextlib
import re
import resource
import sqlite3
import struct
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, ReaderError, metadata, reader
from rosbags.rosbag2.storage_mcap import (
    ChunkInfo,
    McapReader,
    decompress,
    read_bytes,
    read_sized,
    read_string,
)

from fvs_tools import yaml_text
from fvs_tools.bag import NOTES, TYPES

_METADATA = "metadata.yaml"
_MCAP, _SQLITE = ".mcap", ".db3"
#: How rosbag2 numbers the files of one bag, from 0.
_PART = re.compile(r"(.*)_(\d+)(\.\w+)")
#: A bag's next file begins so soon after the one before: its topics came all the time, s.
_GOES_ON_S = 10.0
#: An MCAP file begins and ends with it.
_MAGIC = b"\x89MCAP0\r\n"
#: Kinds of records in an MCAP file: of what has no kind, nothing more was written.
_NOTHING, _CHUNK, _NOTE, _END = 0x00, 0x06, 0x0C, 0x0F
#: Before each record: its kind and its length, bytes.
_HEAD = struct.Struct("<BQ")
#: A chunk's first and last time, its length once unpacked, and the check of that.
_CHUNK_HEAD = struct.Struct("<QQQI")


#: What a bag may take of the memory, bytes: a small file may claim, or unpack to, any size.
_MOST_MEMORY = 2**32


class _Yaml(metadata.YAML):
    """In place of rosbags' own, which takes aliases, in metadata and in texts therein."""

    def load(self, stream: Any) -> Any:
        return yaml_text.read(stream)


metadata.YAML = reader.YAML = _Yaml  # type: ignore[misc]


class BagError(ValueError):
    """A bag that cannot be looked at; the text says why."""


class Record(NamedTuple):
    """A whole record of an MCAP file: its kind, and where it begins and its content lies, bytes."""

    kind: int
    start: int
    content: int
    length: int


def storages(path: Path) -> tuple[list[Path], bool]:
    """What of a bag is to be opened: its folder, or its files where the folder is not whole.

    Returns
    -------
    paths : list of Path
        The folder, or files.
    cut_off : bool
        Whether the recorder never finished it.

    Raises
    ------
    BagError
        If there is no bag, or more than one.
    """
    if not path.exists():
        raise BagError(f"there is no {path}")
    if not path.is_dir():
        return [path], is_cut_off(path)
    files = sorted(one for one in path.iterdir() if one.suffix in (_MCAP, _SQLITE))
    listed = _listed(_yaml(path / _METADATA))
    files = [one for one in files if one.name in listed] or files
    cut_off = any(map(is_cut_off, files))
    if (path / _METADATA).is_file() and not cut_off:
        if (path / _METADATA).stat().st_size > yaml_text.MOST_BYTES:
            raise BagError(f"cannot read {path}: {_METADATA} is too large")
        return [path], False
    if not files:
        raise BagError(f"{path} is no bag: it holds neither {_METADATA} nor an {_MCAP} file")
    if len(files) > 1:
        files = _parts(path, files)
    # SQLite's files stay whole, but without metadata they lack what was not yet in them.
    return files, cut_off or any(one.suffix == _SQLITE for one in files)


def _listed(content: Any) -> set[str]:
    """Names of the files that are a bag's, as its metadata say; empty where they do not."""
    paths = _part(_part(content, "rosbag2_bagfile_information"), "relative_file_paths")
    return {Path(str(one)).name for one in paths} if isinstance(paths, list) else set()


def _parts(folder: Path, files: Sequence[Path]) -> list[Path]:
    """Several files in order, if they are named as those of one bag that was split."""
    matches = [match for one in files if (match := _PART.fullmatch(one.name))]
    parts = {int(match[2]): folder / match[0] for match in matches}
    names = {(match[1], match[3]) for match in matches}
    whole = len(matches) == len(files) and sorted(parts) == list(range(len(files)))
    if not whole or len(names) > 1:
        raise _several(folder, files)
    return [parts[number] for number in range(len(files))]


def _several(folder: Path, files: Sequence[Path]) -> BagError:
    names = ", ".join(one.name for one in files)
    return BagError(f"{folder} holds several bags, name one: {names}")


@contextlib.contextmanager
def bounded_memory() -> Iterator[None]:
    """Raise a ``MemoryError`` where this process would take more than a bag may, on Linux."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = _MOST_MEMORY if soft == resource.RLIM_INFINITY else min(soft, _MOST_MEMORY)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@contextlib.contextmanager
def opened(folder: Path, paths: Sequence[Path]) -> Iterator[AnyReader]:
    """A reader of all of them; those that were cut off are read as far as whole.

    Raises
    ------
    BagError
        If they do not follow one another, as the parts of one bag do.
    """
    reader = AnyReader(paths, default_typestore=TYPES)
    for path, one in zip(paths, reader.readers, strict=True):
        if isinstance(one, Reader) and is_cut_off(path):
            one.storage = CutOffReader(path)
    with reader:
        times_ns = [(one.start_time, one.end_time) for one in reader.readers if one.message_count]
        for (_, end_ns), (start_ns, _) in pairwise(times_ns):
            if abs(start_ns - end_ns) > _GOES_ON_S * 1e9:
                raise _several(folder, paths)
        yield reader


def is_cut_off(path: Path) -> bool:
    """Whether this is an MCAP file without its end."""
    if path.suffix != _MCAP or not path.is_file():
        return False
    with path.open("rb") as file:
        if not _MAGIC.startswith(file.read(len(_MAGIC))):
            return False  # no MCAP file at all
        file.seek(max(len(_MAGIC), path.stat().st_size - len(_MAGIC)))
        return file.read() != _MAGIC


def records(file: BinaryIO) -> Iterator[Record]:
    """The whole records of an MCAP file, up to the end of its data or to the first broken one."""
    size = file.seek(0, 2)
    start = len(_MAGIC)
    while start + _HEAD.size <= size:
        file.seek(start)
        kind, length = _HEAD.unpack(file.read(_HEAD.size))
        content = start + _HEAD.size
        if kind in (_NOTHING, _END) or content + length > size:
            return
        yield Record(kind, start, content, length)
        start = content + length


class CutOffReader(McapReader):
    """What is whole of an MCAP file whose end, with its index, is missing."""

    def open(self) -> None:
        """Look through the file; the parent's would begin at its end."""
        self.bio = self.path.open("rb")
        self.data_start = self.data_end = len(_MAGIC)
        chunks: list[ChunkInfo] = []
        for record in records(self.bio):
            if record.kind == _CHUNK:
                try:
                    chunks.append(_chunk(self.bio, record))
                except Exception:  # of the unpacking; what follows hangs in the air
                    break
            self.data_end = record.content + record.length
        self.meta_scan()
        assert self.statistics is not None
        counts = self.statistics.channel_message_counts
        self.connections = [
            one._replace(msgcount=counts.get(one.id, 0)) for one in self.connections
        ]
        for chunk in chunks:
            chunk.channel_count.update(counts)  # which of them are in this one, it tells itself
        self.chunks = chunks
        self.metadata = self.metadata._replace(
            message_count=self.statistics.message_count,
            start_time=self.statistics.start_time,
            end_time=self.statistics.end_time + 1,  # after the latest message, as the parent has it
        )

    def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
        """All messages in order: the parent's way, which refuses disorder outside of chunks."""
        if self.chunks:
            return super().messages(connections, start, stop)
        return iter(sorted(self.messages_scan(connections, start, stop), key=lambda one: one[1]))


def _chunk(file: BinaryIO, record: Record) -> ChunkInfo:
    """A chunk that can be unpacked; any error if it cannot."""
    file.seek(record.content)
    chunk = BytesIO(file.read(record.length))
    first_ns, last_ns, size, check = _CHUNK_HEAD.unpack(chunk.read(_CHUNK_HEAD.size))
    name, packed = read_string(chunk), read_sized(chunk)
    decompress(packed, name, size, check)
    return ChunkInfo(
        message_start_time=first_ns,
        message_end_time=last_ns,
        chunk_start_offset=record.start,
        chunk_length=_HEAD.size + record.length,
        message_index_offsets={},
        message_index_length=0,
        compression=name,
        compressed_size=len(packed),
        uncompressed_size=size,
        channel_count={},
    )


# --- notes ---


def notes(paths: Sequence[Path]) -> Mapping[str, str]:
    """What travels beside the messages of what was opened: its ``custom_data``.

    Those of a folder are in its metadata, those of a file in it. The recorder of this project
    leaves them beside a file that it could not finish.
    """
    for path in paths:
        folder = path if path.is_dir() else path.parent
        whole = [folder / _METADATA] if path.is_dir() or is_cut_off(path) else []
        sources: list[Path | str] = [*whole, *_written_in(path)]
        for content in map(_yaml, sources):
            # Metadata have a name over them in a file of their own.
            told = _part(content, "rosbag2_bagfile_information") or content
            found = _strings(_part(told, "custom_data"))
            if found:
                return found
        found = _strings(_yaml(folder / NOTES)) if path.is_file() else {}
        if found:
            return found
    return {}


def _written_in(path: Path) -> list[str]:
    """A file's own copy of the metadata, the newest one first."""
    if path.suffix == _MCAP and path.is_file():
        return _written_in_mcap(path)
    if path.suffix == _SQLITE:
        return _written_in_sqlite(path)
    return []


def _written_in_mcap(path: Path) -> list[str]:
    found = []
    with path.open("rb") as file:
        for record in records(file):
            if record.kind == _NOTE and record.length <= 2 * yaml_text.MOST_BYTES:
                file.seek(record.content)
                note = BytesIO(file.read(record.length))
                with contextlib.suppress(ReaderError, struct.error, UnicodeDecodeError):
                    if read_string(note) == "rosbag2":
                        content = BytesIO(read_bytes(note))
                        pairs = {}
                        while content.tell() < len(content.getbuffer()):
                            name = read_string(content)
                            pairs[name] = read_string(content)
                        found.append(pairs.get("serialized_metadata", ""))
    return found[::-1]


def _written_in_sqlite(path: Path) -> list[str]:
    query = "SELECT metadata FROM metadata ORDER BY id DESC"
    with (
        contextlib.suppress(sqlite3.Error),  # older bags have no such table
        contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as bag,
    ):
        return [str(text) for (text,) in bag.execute(query)]
    return []


def _part(content: Any, name: str) -> Any:
    return content.get(name) if isinstance(content, dict) else None


def _strings(content: Any) -> dict[str, str]:
    items = content.items() if isinstance(content, dict) else ()
    return {str(key): str(value) for key, value in items}


def _yaml(source: Path | str) -> Any:
    """YAML of a file or a text, or None."""
    with contextlib.suppress(OSError, ValueError):
        if isinstance(source, Path):
            return yaml_text.read_file(source)
        return yaml_text.read(source)
    return None
