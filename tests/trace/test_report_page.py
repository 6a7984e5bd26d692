"""The report page: self-contained, complete, and safe against the content of a recording."""

import html.parser
import re

from msgspec.structs import replace

from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta
from canopen_control.trace.report_build import facts_of
from canopen_control.trace.report_page import page_of


class Parser(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.references, self.open = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.references += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action")]
        if tag not in ("meta", "line", "rect", "path", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parsed(page):
    parser = Parser()
    parser.feed(page)
    assert parser.open == []
    return parser


def test_nothing_is_fetched_and_nothing_runs(lost_drive):
    page = page_of(facts_of(lost_drive))
    parser = parsed(page)
    assert parser.references == []
    assert "script" not in parser.tags
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|url\(|@import", page)


def test_a_calm_run_shows_its_last_frames(calm_run):
    page = page_of(facts_of(calm_run))
    assert "The last frames" in page
    assert 'class="sum "' in page


def test_what_is_in_a_recording_is_text_and_never_markup(lost_drive):
    evil = '"><script>alert(1)</script>'
    boot = [replace(step, error=evil) for step in lost_drive.meta.status.boot]
    lost_drive.meta = replace(lost_drive.meta, robot=evil, status=replace(lost_drive.meta.status, boot=boot))
    lost_drive.events = [replace(event, text=evil) for event in lost_drive.events]
    page = page_of(facts_of(lost_drive))
    assert "script" not in parsed(page).tags
    assert "&lt;script&gt;" in page


def test_an_empty_recording_has_a_page():
    page = page_of(facts_of(FlightFile(FlightMeta(robot="", reason=NO_FAULT))))
    parsed(page)
    assert "No error was reported" in page
    assert "<svg" not in page
