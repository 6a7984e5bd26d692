"""The page of a report in a real browser, from a file: in light, dark, on paper and on a small screen."""

import pytest
from support.browser import browser
from support.flightstory import record

from canopen_control.trace.report_build import facts_of
from canopen_control.trace.report_page import page_of

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def page_text(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        return page_of(facts_of(record("browsed", seconds=3, power_off_after=1.5)))


@pytest.fixture
def opened(tmp_path):
    """Return what opens a page from a file: the page, its requests and what its console said."""
    with browser() as running:

        def open_page(text):
            path = tmp_path / "report.html"
            path.write_text(text, encoding="utf-8")
            page, requests, output = running.new_page(), [], []
            page.on("request", lambda request: requests.append(request.url))
            page.on("console", lambda message: output.append(message.text))
            page.goto(path.as_uri())
            return page, requests, output

        yield open_page


def colour(page):
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


def test_it_asks_for_nothing_complains_of_nothing_and_fits(opened, page_text):
    page, requests, text = opened(page_text)
    for width in (420, 1000, 1600):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert requests == [page.url]
    assert text == []
    assert "left_drive" in page.inner_text(".sum")
    assert page.locator("svg").count() >= 6
    assert page.locator("svg rect").first.is_visible()


def test_a_foreign_request_would_be_seen_and_is_refused(opened, page_text):
    evil = page_text.replace("</body>", '<img src="http://127.0.0.1:9/x.png"></body>')
    _, requests, text = opened(evil)
    assert any("Content Security Policy" in line for line in text) or len(requests) > 1


def test_it_is_dark_where_the_reader_needs_that_and_light_on_paper(opened, page_text):
    page, _, _ = opened(page_text)
    page.emulate_media(color_scheme="light")
    assert colour(page) == "rgb(255, 255, 255)"
    page.emulate_media(color_scheme="dark")
    assert colour(page) == "rgb(13, 17, 23)"
    page.emulate_media(media="print", color_scheme="dark")
    assert colour(page) == "rgb(255, 255, 255)"
