"""The printed tag has its true size, and is the one that the detector reads."""

import cv2
import numpy as np
import pytest

from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import Tag
from fvs_tools import tag as program


def test_a_page_shows_the_tag_in_true_size(tmp_path):
    path, family, number = tmp_path / "tag.png", "4X4_50", 7
    given = ["-o", str(path), "--dictionary", family, "--id", str(number), "--size-m", "0.08"]
    assert program.main(given) == 0
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert page.shape == pytest.approx((297.0 / 25.4 * 600, 210.0 / 25.4 * 600), abs=1.0)
    corners, why = TagReader(Tag(family, number)).read(page)
    assert corners, why
    tag = corners[number].px
    sides_mm = np.linalg.norm(np.roll(tag, -1, axis=0) - tag, axis=1) * 25.4 / 600
    np.testing.assert_allclose(sides_mm, 80.0, atol=0.1)


def test_a_page_shows_all_tags_of_a_layout_at_their_places(tmp_path):
    path, tag = tmp_path / "tags.png", Tag(tag_size_m=0.04, tag_layout="cube")
    assert program.main(["-o", str(path), "--layout", "cube", "--size-m", "0.04"]) == 0
    corners, why = TagReader(tag).read(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    assert len(corners) == 5, why
    apart_mm = np.linalg.norm(corners[1].px.mean(axis=0) - corners[0].px.mean(axis=0)) * 25.4 / 600
    assert apart_mm == pytest.approx(50.0, abs=0.05)  # with the border of one cell


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--size-m", "0.2"], "takes tags of 0.152 m at most"),
        (["--dictionary", "36h11"], "tag_dictionary must be one of"),
        (["--id", "9999"], "tag_id 9999 is not in APRILTAG_36h11"),
        (["-o", "tag.jpg"], "must end in .pdf or .png"),
        (["-o", "/nowhere/tag.pdf"], "/nowhere"),
    ],
)
def test_what_cannot_be_printed_is_refused(given, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert program.main(given) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_usual_page_is_a_pdf(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert program.main([]) == 0
    assert (tmp_path / "tag.pdf").read_bytes().startswith(b"%PDF")
