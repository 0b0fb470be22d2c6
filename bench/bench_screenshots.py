"""Screenshots of the page: ``python -m bench screenshots docs/images`` renews the documentation's.

Without a folder they go to ``out/screenshots``. It needs playwright and chromium.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: By name of the file: size of the window, px, and parameters of the scenario ``dashboard``.
VIEWS: dict[str, tuple[int, int, tuple[str, ...]]] = {
    "dashboard": (1280, 800, ()),
    "dashboard_tag": (1280, 840, ("feature:=pose",)),
    "dashboard_webcams": (1280, 800, ("feature:=points",)),
}
#: In lock step, so that a busy computer does not hold the arm.
SLOWLY = "port:=0", "simulated_time:=true", "use_sim_time:=true"
#: WebGL is drawn by software.
FLAGS = "--disable-gpu", "--enable-unsafe-swiftshader"
#: Drawn some times a second only: by software every picture takes a core for tens of milliseconds.
SELDOM = "window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 500)"
#: Whether the arm is on its way, with a new picture.
MOVING = """document.getElementById("fvs-banner").dataset.state == "SERVOING"
    && parseFloat(document.getElementById("fvs-error").innerText) > 20
    && !document.querySelector("#fvs-picture, #fvs-next").innerText"""
#: The curves are full after 20 s; the browser has drawn what it was told after some pictures.
CURVES_MS, DRAWN_MS, PATIENCE_MS = 20_000, 1500, 180_000


def browser() -> str | None:
    """Path of chromium, if it is installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def window(width: int, height: int) -> Iterator[Any]:
    """An empty page in a window of chromium, px."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        chromium = tool.chromium.launch(executable_path=browser(), headless=True, args=FLAGS)
        page = chromium.new_page(viewport={"width": width, "height": height})
        page.add_init_script(SELDOM)
        yield page
        chromium.close()


def shoot(path: Path, width: int, height: int, parameters: tuple[str, ...]) -> None:
    """Start the scenario, wait until there is something to see, and write the picture."""
    settings = [word for each in (*SLOWLY, *parameters) for word in ("-p", each)]
    command = [sys.executable, "-m", "fvs_tools.launcher", "dashboard", *settings]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None

        def to_nodes(name: str) -> None:
            subprocess.run(["pkill", f"-{name}", "-P", str(process.pid)], check=False)

        try:
            found = (re.search(r"page: (\S+)$", line.rstrip()) for line in process.stdout)
            address = next(match[1] for match in found if match)
            with window(width, height) as page:
                page.goto(address)
                page.wait_for_selector("#fvs-banner", timeout=PATIENCE_MS)
                page.locator(".mantine-Notification-closeButton").first.click()
                while True:
                    page.wait_for_timeout(CURVES_MS)
                    page.wait_for_function(MOVING, timeout=PATIENCE_MS)
                    # A screenshot takes seconds: meanwhile all nodes rest.
                    to_nodes("STOP")
                    page.wait_for_timeout(DRAWN_MS)
                    if page.evaluate(MOVING):
                        style = "#fvs-lost { display: none }"
                        page.screenshot(path=path, style=style, timeout=PATIENCE_MS)
                        break
                    to_nodes("CONT")
        finally:
            to_nodes("CONT")
            process.send_signal(signal.SIGINT)
    print(path)


def main() -> None:
    """Write all."""
    folder = Path(*sys.argv[1:2] or ("out/screenshots",))
    folder.mkdir(parents=True, exist_ok=True)
    for name, view in VIEWS.items():
        shoot(folder / f"{name}.png", *view)
