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
from fvs_ros.paths import output_file
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK

#: A4.
_PAGE_MM = np.array([210.0, 297.0])
#: Width of a glue flap, in widths of a tag.
_FLAP = 0.2


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        tag = Tag(arguments.dictionary, arguments.id, arguments.size_m, arguments.layout)
        draw(tag, output_file(arguments.output, ".pdf", ".png"))
    except (ValueError, OSError, ImportError) as error:  # of matplotlib
        print(f"fvs_tag: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    print(
        f"{arguments.output}: print it at 100 %, measure a black square, and start the detector "
        f"with -p feature:=pose -p tag_layout:={tag.tag_layout} -p tag_size_m:=... "
        f"(here {tag.tag_size_m:g})"
    )
    return EXIT_OK


def draw(tag: Tag, path: Path) -> None:
    """Write an A4 page with the tags in true size as PDF or PNG, by the path's ending.

    A ``ValueError`` if there is no such tag, or they do not fit.
    """
    from matplotlib.figure import Figure  # slow, and not needed for --help

    TagReader(tag)  # checks the numbers
    size_mm, pitch_mm = 1e3 * tag.tag_size_m, 1e3 * tag.pitch_m
    centres_mm = pitch_mm * np.array(LAYOUTS[tag.tag_layout])
    width_mm, height_mm = pitch_mm + np.ptp(centres_mm, axis=0)
    most_mm = _PAGE_MM[0] - 20.0  # margins that a printer may need
    if width_mm > most_mm:
        raise ValueError(
            f"an A4 page takes the layout {tag.tag_layout} with tags of at most "
            f"{1e-3 * np.floor(most_mm * size_mm / width_mm):g} m, got {tag.tag_size_m:g} m"
        )
    figure = Figure(figsize=(_PAGE_MM[0] / 25.4, _PAGE_MM[1] / 25.4))
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.axis("off")
    middle = _PAGE_MM * (0.5, 0.6)
    for number, centre in zip(tag.faces, middle + centres_mm, strict=True):
        picture = cv2.aruco.generateImageMarker(tag.dictionary, number, 100 * tag.cells)
        (left, bottom), (right, top) = centre - 0.5 * size_mm, centre + 0.5 * size_mm
        extent = (left, right, bottom, top)
        page.imshow(picture, "gray", interpolation="nearest", aspect="auto", extent=extent)
    for edges, dashes in zip(_edges(tag), ((), (8, 6)), strict=True):
        for edge in edges:
            page.plot(*(middle + pitch_mm * edge).T, color="0.4", linewidth=0.5, dashes=dashes)
    page.set(xlim=(0.0, _PAGE_MM[0]), ylim=(0.0, _PAGE_MM[1]))
    below = middle[1] - 0.5 * height_mm
    numbers = f"number {tag.tag_id}"
    if len(tag.faces) > 1:
        numbers = f"numbers {tag.tag_id} to {max(tag.faces)}"
    words = [f"{tag.tag_dictionary}, {numbers}: a black square is {size_mm:g} mm wide"]
    if tag.tag_layout == "cube":
        words.append(f"cut solid lines, fold dashed ones, glue to a cube of {pitch_mm:.2f} mm")
    for line, text in enumerate([*words, "this line is 100 mm long"], start=1):
        page.text(middle[0], below - 8.0 * line, text, ha="center", size=12)
    ends = middle[0] + np.array([-50.0, 50.0])
    page.plot(ends, [below - 8.0 * len(words) - 13.0] * 2, "k|-", linewidth=0.5, markersize=9)
    figure.savefig(path, dpi=600)


def _edges(tag: Tag) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Edges to cut and to fold, in widths of a tag, each (k, 2) from the middle, right and up."""
    cuts, folds = dict[tuple[float, ...], np.ndarray](), list[np.ndarray]()
    for centre in np.array(LAYOUTS[tag.tag_layout]):
        for out in np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]):
            along, middle = 0.5 * out[::-1], centre + 0.5 * out
            edge = np.array([middle - along, middle + along])
            if cuts.pop(tuple(middle), None) is None:
                cuts[tuple(middle)] = edge
            elif tag.tag_layout == "cube":
                folds.append(edge)
            # Flaps of two sides of a cube glue all four together.
            if tag.tag_layout == "cube" and centre[0] and out[1]:
                flap = edge + _FLAP * np.array([out + 2.0 * along, out - 2.0 * along])
                cuts[tuple(middle)] = np.array([edge[0], *flap, edge[1]])
                folds.append(edge)
    return [*cuts.values()], folds


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
