"""YAML from untrusted files: no aliases, nothing oversized."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

#: No YAML is larger; no refusal quotes more of it, characters.
MOST_BYTES, QUOTED = 2**20, 300


class _Loader(yaml.SafeLoader):
    """YAML without aliases: a few lines of them can unfold to more than any memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken")
        return super().compose_node(parent, index)


def read(text: str) -> Any:
    """What a text holds; a ``ValueError`` says in short what is wrong with it."""
    if len(text) > MOST_BYTES:
        raise ValueError(f"it is larger than {MOST_BYTES >> 20} MB")
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except yaml.reader.ReaderError:
        raise ValueError("it is binary, expected text") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise ValueError(str(error)[:QUOTED]) from None


def read_file(path: Path) -> Any:
    """What a file holds; a ``ValueError`` as of :func:`read`, or an ``OSError``."""
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    try:
        return read(content.decode("utf-8"))
    except UnicodeDecodeError:
        raise ValueError("it is binary, expected text") from None
