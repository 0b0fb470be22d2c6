"""YAML from untrusted files: no aliases, nothing oversized, and short words for what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

#: Largest YAML, and longest quotation of it in an error, characters.
_MOST_YAML, QUOTED = 2**20, 300


class _Loader(yaml.SafeLoader):
    """YAML without aliases: a few lines of them can expand beyond any memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken")
        return super().compose_node(parent, index)


def read_yaml(text: str | bytes) -> Any:
    """The content of a YAML text; a ``ValueError`` explains briefly what is wrong."""
    if len(text) > _MOST_YAML:
        raise ValueError(f"it is larger than {_MOST_YAML >> 20} MB")
    try:
        return _Loader(text).get_single_data()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except yaml.reader.ReaderError:
        raise ValueError("it is binary, expected text") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise ValueError(str(error)[:QUOTED]) from None


def read_yaml_file(path: Path) -> Any:
    """The content of a YAML file; raises as :func:`read_yaml`, or an ``OSError``."""
    with path.open("rb") as file:
        return read_yaml(file.read(_MOST_YAML + 1))
