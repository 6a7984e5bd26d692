"""`idle`: the CPU use of a robot at standstill at 50 Hz: its runtime, and its view with one browser and four.

The browsers are headless chromiums, each a client of its own. They draw without a graphics card, which takes more than
all that is measured: only the CPU of the view counts. Without a chromium (or the one that CHROMIUM names) and
playwright the runtime alone is measured.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import time
from typing import TYPE_CHECKING, Final

from canopen_control_bench.clients import has_extra
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.machine import cpu_ns
from canopen_control_bench.stage import TIMEOUT_S, stage
from canopen_control_bench.start import run_robby

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

    from canopen_control_bench.runner import Options
    from canopen_control_bench.stage import Program, Stage


RUNTIME_LIMIT: Final = 0.015  # of a core
#: browsers -> cores of the view
VIEW_LIMITS: Final = {1: 0.03, 4: 0.08}
_CHROMIUM: Final = os.environ.get("CHROMIUM", "/usr/bin/chromium")
_SECONDS: Final = 20.0
_SETTLE_S: Final = 5.0  # the first pictures
_ROBOT: Final = "idle"


def measure(options: Options) -> list[Figure]:
    """Measure what is installed; a quick run has nothing to check here."""
    if options.quick:
        return []
    seconds = options.seconds or _SECONDS
    with stage() as played:
        robot = run_robby(played, _ROBOT)
        cores = _cores(robot, seconds)
        figures = [limited("robby stands, 50 Hz: cores of the runtime", "", [cores], limit=RUNTIME_LIMIT)]
        if _has_browser():
            figures += _view(played, seconds)
        robot.end()
    return figures


def _view(played: Stage, seconds: float) -> list[Figure]:
    """Connect more and more browsers to the robot."""
    view = played.start("canopen_control", "view", "--name", _ROBOT, "--port", "0")
    url = view.until("view: http").split()[-1]
    view.drain()
    figures = []
    with _browser() as browser:
        for count, limit in VIEW_LIMITS.items():
            while len(browser.contexts) < count:
                _look(browser, url)
            name = f"robby stands, {count} browser{'s' if count > 1 else ''}: cores of the view"
            figures.append(limited(name, "", [_cores(view, seconds)], limit=limit))
    view.end()
    return figures


def _cores(program: Program, seconds: float) -> float:
    """Return the CPU use of a program in cores, after its start-up has settled."""
    time.sleep(min(_SETTLE_S, seconds))
    begin, before = time.monotonic(), cpu_ns(program.pid)
    time.sleep(seconds)
    return (cpu_ns(program.pid) - before) / 1e9 / (time.monotonic() - begin)


def _has_browser() -> bool:
    return os.access(_CHROMIUM, os.X_OK) and has_extra("view") and importlib.util.find_spec("playwright") is not None


@contextlib.contextmanager
def _browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright  # a big one, which this family alone needs

    with sync_playwright() as playwright:
        words = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"]
        words.append("--no-sandbox")  # for root; the only page is our own
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=words)
        try:
            yield browser
        finally:
            browser.close()


def _look(browser: Browser, url: str) -> None:
    """Open the page as another user, and wait until it shows the robot."""
    page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
    page.set_default_timeout(TIMEOUT_S * 1000)
    page.goto(url, wait_until="commit")
    page.get_by_role("button", name="STOP", exact=True).wait_for()
    page.get_by_text("cycle 20 ms").wait_for()
    page.wait_for_function("() => !!window.ccScene")
