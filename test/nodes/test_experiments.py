"""The whole laboratory in its quick mode, as a user calls it, real nodes included."""

import json
import os
import subprocess
import sys

import pytest

from fvs_ros.apps.experiments.report import EXPERIMENTS


@pytest.mark.timeout(240)
def test_quick_mode_makes_a_complete_page(tmp_path):
    ended = subprocess.run(
        [
            *(sys.executable, "-m", "fvs_ros.apps.experiments.main", "all"),
            *("--quick", "--camera", "exact", "--jobs", "2", "--out", str(tmp_path)),
        ],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        capture_output=True,
        text=True,
        timeout=220,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    for name in EXPERIMENTS:
        report = json.loads((tmp_path / name / "results.json").read_text(encoding="utf-8"))
        assert report["verdicts"]
        assert report["figures"]
        assert report["tables"]
        assert report["data"]
        assert f'<section id="{name}">' in page
        for figure in report["figures"]:
            png = (tmp_path / name / figure["file"]).read_bytes()
            assert png.startswith(b"\x89PNG")
    assert page.count("data:image/png;base64,") >= 2 * len(EXPERIMENTS)
    assert 'src="' not in page.replace('src="data:', "")  # nothing from elsewhere

    servo = json.loads((tmp_path / "servo" / "results.json").read_text(encoding="utf-8"))
    (check,) = servo["data"]["spot_check"]
    assert check["problem"] == ""
    assert len(check["nodes_s"]) == 4
    assert all(len(times) == 4 for times in check["lock_step_s"])
    assert None not in check["nodes_s"]
