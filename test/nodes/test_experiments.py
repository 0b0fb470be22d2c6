"""The laboratory in its quick mode, as a user calls it, real nodes included.

The one experiment that runs nodes; the others are in test/closed_loop.
"""

import json
import os
import subprocess
import sys

import pytest


@pytest.mark.timeout(240)
def test_quick_mode_makes_a_complete_page_with_nodes_beside_it(tmp_path):
    ended = subprocess.run(
        [
            *(sys.executable, "-m", "fvs_lab.main", "servo"),
            *("--quick", "--seeds", "1", "--camera", "exact", "--jobs", "2"),
            *("--out", str(tmp_path)),
        ],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        capture_output=True,
        text=True,
        timeout=220,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    report = json.loads((tmp_path / "servo" / "results.json").read_text(encoding="utf-8"))
    assert report["verdicts"]
    assert report["figures"]
    assert report["tables"]
    assert '<section id="servo">' in page
    for figure in report["figures"]:
        assert (tmp_path / "servo" / figure["file"]).read_bytes().startswith(b"\x89PNG")
    assert page.count("data:image/png;base64,") >= 2
    assert 'src="' not in page.replace('src="data:', "")  # nothing from elsewhere

    (check,) = report["data"]["spot_check"]
    assert check["problem"] == ""
    assert len(check["nodes_s"]) == 1
    assert len(check["lock_step_s"]) == 2
    assert all(len(times) == 1 for times in check["lock_step_s"])
    assert None not in check["nodes_s"]
