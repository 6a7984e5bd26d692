"""A headless browser for tests and pictures: Debian's chromium, driven by playwright, on a software renderer."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from playwright.sync_api import Browser, Page

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
_ARGUMENTS = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",  # tests run as root in containers; the only pages are our own
    "--disable-background-networking",
    "--disable-component-update",
)
TIMEOUT_MS = 60_000
LEFT_WHEEL, RIGHT_WHEEL = "left_wheel", "right_wheel"
BASE = "base"


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """Run chromium as long as the `with` block lasts."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        with _priority(-5):
            running = playwright.chromium.launch(executable_path=CHROMIUM, args=list(_ARGUMENTS))
        try:
            yield running
        finally:
            running.close()


@contextlib.contextmanager
def without_webgl(running: Browser) -> Iterator[Browser]:
    """Run another chromium, which draws no 3D, beside one that runs."""
    flat = running.browser_type.launch(
        executable_path=CHROMIUM, args=["--disable-gpu", "--disable-3d-apis", "--no-sandbox"]
    )
    try:
        yield flat
    finally:
        flat.close()


@contextlib.contextmanager
def _priority(nice: int) -> Iterator[None]:
    """Start what is started here before others, where the user may: it draws without a graphics card."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


class RobotPage:
    """The page of the view as a user has it, with every request that it has made in `requests`."""

    def __init__(self, browser: Browser, url: str, size: tuple[int, int] = (1440, 900)) -> None:
        self.url = url
        self.page: Page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.set_default_timeout(TIMEOUT_MS)
        self.requests: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda websocket: self.requests.append(websocket.url))

    def open(self, *, scene: bool = True) -> RobotPage:
        """Open it and wait until the robot is there, with its `scene` if there is to be one."""
        self.page.goto(self.url, wait_until="commit")
        self.page.get_by_role("button", name="STOP", exact=True).wait_for()
        self.page.get_by_text("cycle 20 ms").wait_for()
        if scene:
            self.page.wait_for_function("() => !!window.ccScene")
        # Without a graphics card the first picture takes many seconds on a busy machine, during which nothing else
        # runs.
        self.pictures(2)
        self.page.wait_for_timeout(500)  # the page is at rest: a button that moves under the pointer is released
        return self

    def pictures(self, count: int) -> None:
        """Wait until the page has been drawn so many times more."""
        self.page.evaluate(
            "count => new Promise(done => {"
            " const next = () => count-- ? requestAnimationFrame(next) : done(); next(); })",
            count,
        )

    def fetched(self, url: str) -> str:
        """Return the result of a request by the page, "" if it loads again, as it does if its server was late."""
        from playwright.sync_api import Error

        try:
            return str(self.page.evaluate("url => fetch(url).then(() => 'sent', error => String(error))", url))
        except Error:
            return ""

    def transform(self, node: str) -> list[float]:
        """Return the sixteen numbers of a link's world matrix in the scene that three.js draws, column by column."""
        matrix: list[float] = self.page.evaluate("name => window.ccScene.place(name)", node)
        return matrix

    def press(self, label: str) -> None:
        """Press a button down, the first of its name, and keep it; the page is scrolled to where it is in sight.

        Not by playwright's own way, which waits for drawn pictures: without a graphics card there are few.
        """
        button = self.page.get_by_role("button", name=label, exact=True).first
        button.wait_for()
        if (box := button.bounding_box()) and box["y"] + box["height"] > self.page.evaluate("window.innerHeight"):
            button.evaluate("button => button.scrollIntoView({block: 'center'})")
        box = button.bounding_box()
        assert box is not None
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()

    def click(self, label: str) -> None:
        """Press a button and let it go."""
        self.press(label)
        self.page.mouse.up()

    def text(self) -> str:
        """Return what can be read on it."""
        return str(self.page.inner_text("body"))

    def foreign(self) -> list[str]:
        """Return the requests that went anywhere but to where the page came from; data: and blob: go nowhere."""
        own = urlsplit(self.url).netloc
        return [
            url for url in self.requests if urlsplit(url).scheme not in ("data", "blob") and urlsplit(url).netloc != own
        ]

    def picture(self, path: Path) -> Path:
        """Take a picture of what is shown."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=path)
        return path
