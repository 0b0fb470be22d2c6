"""YAML from untrusted files: no aliases, nothing oversized, and short words for what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

#: Largest YAML, and longest quotation of it in an error, characters.
_MOST_YAML, QUOTED = 2**20, 300
#: libyaml's, where PyYAML was built with it, are ten times as fast.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def read_yaml(text: str | bytes, most: int = _MOST_YAML) -> Any:
    """The content of a YAML text; a ``ValueError`` explains briefly what is wrong."""
    if len(text) > most:
        raise ValueError(f"it is larger than {most >> 10} kB")
    try:
        # A few lines of aliases can expand beyond any memory.
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, _Loader)):
            raise yaml.YAMLError("aliases (*name) are not taken")
        return _Loader(text).get_single_data()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except yaml.reader.ReaderError:
        raise ValueError("it is binary, expected text") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise ValueError(str(error)[:QUOTED]) from None


def read_yaml_file(path: Path, most: int = _MOST_YAML) -> Any:
    """The content of a YAML file; raises as :func:`read_yaml`, or an ``OSError``."""
    with path.open("rb") as file:
        return read_yaml(file.read(most + 1), most)


def write_yaml(content: Any) -> str:
    """The content as YAML, in its order, with the innermost lists and mappings in one line."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None)
