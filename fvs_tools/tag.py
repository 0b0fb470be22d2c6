"""``fvs_tag``: a page with a tag, a plate or a cube of tags to print, in true size."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import LAYOUTS, Tag
from fvs_ros import console
from fvs_ros.arguments import Parser
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK

_PAGE_MM, _MARGIN_MM, _DPI = (210.0, 297.0), 10.0, 600
_MM_PER_INCH, _CELL_PX = 25.4, 100


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    given = _parser().parse_args(argv)
    try:
        tag = Tag(given.dictionary, given.id, given.size_m, given.layout)
        draw(tag, given.output)
    except (ValueError, OSError) as error:
        print(f"fvs_tag: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    print(
        f"{given.output}: print it at 100 %, measure a black square, and start the detector with "
        f"-p feature:=pose -p tag_layout:={tag.tag_layout} -p tag_size_m:=... "
        f"(here {tag.tag_size_m:g})"
    )
    return EXIT_OK


def draw(tag: Tag, path: Path) -> None:
    """Write an A4 page with the tags in true size as PDF or PNG, by the path's ending.

    A ``ValueError`` if there is no such tag, or they do not fit.
    """
    from matplotlib.figure import Figure  # slow, and not needed for --help
    from matplotlib.patches import Rectangle

    TagReader(tag)  # checks the numbers
    size_mm, pitch_mm = 1e3 * tag.tag_size_m, 1e3 * tag.pitch_m
    places = np.array(LAYOUTS[tag.tag_layout])
    outer_mm = pitch_mm * (1.0 + np.ptp(places[:, 0]))
    most_mm = _PAGE_MM[0] - 2.0 * _MARGIN_MM
    if outer_mm > most_mm:
        raise ValueError(
            f"the page takes tags of {1e-3 * most_mm * size_mm / outer_mm:.3f} m at most, "
            f"got {tag.tag_size_m:g} m"
        )
    if path.suffix not in (".pdf", ".png"):
        raise ValueError(f"the output must end in .pdf or .png, got {path.name}")
    figure = Figure(figsize=(_PAGE_MM[0] / _MM_PER_INCH, _PAGE_MM[1] / _MM_PER_INCH))
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.axis("off")
    middle = np.array([0.5 * _PAGE_MM[0], 0.6 * _PAGE_MM[1]])
    for number, place in zip(tag.faces, places, strict=True):
        low, high = middle + pitch_mm * place - 0.5 * size_mm, middle + pitch_mm * place
        high += 0.5 * size_mm
        picture = cv2.aruco.generateImageMarker(tag.dictionary, number, tag.cells * _CELL_PX)
        page.imshow(
            picture,
            extent=(low[0], high[0], low[1], high[1]),
            cmap="gray",
            interpolation="nearest",
            aspect="auto",
        )
        corner = low - 0.5 * (pitch_mm - size_mm)
        page.add_patch(
            Rectangle(corner, pitch_mm, pitch_mm, fill=False, color="0.8", linewidth=0.3)
        )
    page.set(xlim=(0.0, _PAGE_MM[0]), ylim=(0.0, _PAGE_MM[1]))
    below = middle[1] - 0.5 * pitch_mm * (1.0 + np.ptp(places[:, 1])) - 8.0
    words = f"{tag.tag_dictionary}, number {tag.tag_id}"
    if len(places) > 1:
        words += f" to {tag.tag_id + len(places) - 1}"
    words += f": a black square is {size_mm:g} mm wide"
    if tag.tag_layout == "cube":
        words += f"; cut out, fold, and glue to a cube of {pitch_mm:.2f} mm"
    page.text(middle[0], below, words, ha="center", size=9)
    ruler_mm = 100.0
    start, below = middle[0] - 0.5 * ruler_mm, below - 14.0
    page.plot([start, start + ruler_mm], [below, below], "k|-", linewidth=0.5, markersize=9)
    page.text(middle[0], below - 7.0, "this line is 100 mm long", ha="center", size=9)
    figure.savefig(path, dpi=_DPI)


def _parser() -> argparse.ArgumentParser:
    parser, usual = Parser("fvs_tag", __doc__), Tag()
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("tag.pdf"), help="PDF or PNG file to write"
    )
    default = "(default %(default)s)"
    parser.add_argument(
        "--dictionary", default=usual.tag_dictionary, help=f"family of the tag {default}"
    )
    parser.add_argument("--id", type=int, default=usual.tag_id, help=f"its number {default}")
    parser.add_argument(
        "--layout", default=usual.tag_layout, help=f"single, plate (2 x 2) or cube {default}"
    )
    parser.add_argument(
        "--size-m", type=float, default=usual.tag_size_m, help=f"side of its square, m {default}"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
