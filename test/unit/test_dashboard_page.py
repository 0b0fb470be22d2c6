"""The page as it is served, without ROS: who is let in, and what stands where."""

import re
import types
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

import websockets
from page_client import PageClient
from viser.infra import _infra

from fvs_dashboard import config, guard
from fvs_dashboard.page import Page
from fvs_ros.joints import UR_JOINT_NAMES

ROOT = Path(__file__).resolve().parents[2]


def served(port=0):
    given = config.DashboardConfig(port=port, model_path="any")
    return Page(given, UR_JOINT_NAMES, lambda action: None)


@pytest.fixture
def page():
    page = served()
    yield page
    page.close()


# --- who is let in ---


def test_a_page_whose_guard_did_not_take_is_not_served(monkeypatch):
    # A later viser that keeps websockets' own server, where the guard does not reach it.
    server = types.SimpleNamespace(**vars(websockets.asyncio.server))
    own = {**vars(websockets), "asyncio": types.SimpleNamespace(server=server)}
    monkeypatch.setattr(_infra, "websockets", types.SimpleNamespace(**own))
    tried = []
    check = guard.turns_others_away
    monkeypatch.setattr(
        "fvs_dashboard.page.turns_others_away",
        lambda host, port: tried.append((host, port)) or check(host, port),
    )
    with pytest.raises(ValueError, match="would let any web site command the arm") as refused:
        served()
    assert config.VISER in str(refused.value)
    ((host, port),) = tried
    with pytest.raises(OSError, match="refused"):
        PageClient(f"http://{host}:{port}")


def test_no_other_page_may_hold_this_one_in_a_frame(page):
    with urllib.request.urlopen(page.address, timeout=10.0) as answer:
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert answer.headers["X-Frame-Options"] == "DENY"


def test_a_request_for_a_public_tunnel_is_refused(page, monkeypatch):
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *_: pytest.fail("a tunnel"))
    assert page._server.request_share_url() is None


def test_the_versions_of_viser_are_the_same_everywhere():
    bounds = config.VISER.removeprefix("viser[urdf]")
    for name in ("README.md", "package.xml", "setup.py"):
        found = re.findall(r"viser\[urdf\]([^'\"]*)", (ROOT / name).read_text(encoding="utf-8"))
        assert set(found) == {bounds}, name
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert re.findall(r"^viser(.*)$", constraints, re.M) == [bounds]
