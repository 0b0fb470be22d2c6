"""Arguments of programs and nodes: help, and suggestions for misspelt names."""

from __future__ import annotations

import argparse
import difflib
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn

_WIDTH, _COLUMN = 100, 22
#: Longest part of a wrong name that is compared or repeated, characters.
_QUOTED = 60
#: Most names, all that one looks through, that are listed beside a likely one.
_LISTED = 20


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Refusal of an unknown name, with the nearest known one, or if many are known, all of them."""
    names = list(known)
    meant = did_you_mean(name, names)
    listed = "" if meant and len(names) > _LISTED else f"known are {', '.join(names) or 'none'}"
    return f"unknown {kind} '{name[:_QUOTED]}'; {meant}{listed}".rstrip()


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the nearest known name; empty if none is near."""
    names, part = list(known), name[:_QUOTED]
    near = difflib.get_close_matches(part, names, n=1)
    near += [each for each in names if len(part) > 2 and part.lower() in each.lower()]
    return f"did you mean {near[0]}? " if near else ""


def how_to_install(extras: str, packages: Iterable[str]) -> str:
    """Commands that install missing packages, which these extras (``a,b``) contain."""
    return (
        f"pip install 'fvs_ros[{extras}]', in a checkout .venv/bin/pip install -e '.[{extras}]'; "
        f"in a ROS workspace, pip install {' '.join(packages)}"
    )


class Parser(argparse.ArgumentParser):
    """A parser that suggests the argument that was probably meant.

    Its help shows the docstring of the program's module, and at the end lists: titles, and below
    each names with their texts.
    """

    def __init__(
        self, program: str, doc: str, lists: Mapping[str, Mapping[str, str]] | None = None
    ) -> None:
        super().__init__(
            program,
            description=doc.replace("`", ""),
            epilog="\n\n".join(listing(title, texts) for title, texts in (lists or {}).items()),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self._negative_number_matcher = re.compile(r"-\.?\d")  # -1e-3 is no option, either

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Read the arguments; one that is unknown ends the program with 2."""
        parsed, rest = self.parse_known_args(args, namespace)
        if rest:
            self.error(unknown("argument", rest[0], self._option_string_actions))
        return parsed

    def error(self, message: str) -> NoReturn:
        """End the program with 2, and say where more is to be read."""
        super().error(f"{message}; {self.prog} --help says more")


def listing(title: str, texts: Mapping[str, str]) -> str:
    """Names with their texts in two columns, under a title."""
    lines = [f"{title}:"]
    for name, text in texts.items():
        first = f"  {name} ".ljust(_COLUMN)
        if len(first) > _COLUMN:
            lines.append(first.rstrip())
            first = " " * _COLUMN
        lines.append(
            textwrap.fill(text, _WIDTH, initial_indent=first, subsequent_indent=" " * _COLUMN)
        )
    return "\n".join(lines)
