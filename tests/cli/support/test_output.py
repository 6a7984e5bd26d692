import io
import json
import math

import pytest

from canopen_control.cli.support.output import PLAIN_S, REDRAW_S, SOON_S, Progress, Table, json_line, json_text
from canopen_control.rpc.messages.state import JointReading


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_quick_work_reports_nothing(clock):
    for stream in (Terminal(), io.StringIO()):
        with Progress("reading", stream=stream, clock=clock) as progress:
            clock.now += SOON_S - 0.01
            progress.at(1, 2)
        assert stream.getvalue() == ""


def test_a_terminal_has_one_line_that_is_wiped_at_the_end(clock):
    stream = Terminal()
    progress = Progress("reading 0x1021", "bytes", stream=stream, clock=clock)
    clock.now += SOON_S
    progress.at(34_560, 120_000)
    progress.at(34_561, 120_000)  # not due yet
    clock.now += REDRAW_S
    progress.at(120_000, 120_000)
    progress.end()
    progress.end()
    assert stream.getvalue() == (
        "\rreading 0x1021: 34,560 of 120,000 bytes (28 %), 0 s\x1b[K"
        "\rreading 0x1021: 120,000 of 120,000 bytes (100 %), 1 s\x1b[K"
        "\r\x1b[K"
    )


def test_elsewhere_there_are_plain_lines_now_and_then(clock):
    stream = io.StringIO()
    with Progress("asking nodes", stream=stream, clock=clock) as progress:
        for done in range(120):
            progress.at(done, 127)
            clock.now += 0.125
    assert stream.getvalue() == "asking nodes: 40 of 127 (31 %), 5 s\nasking nodes: 80 of 127 (62 %), 10 s\n"


def test_an_unknown_total_or_nothing_known_at_all(clock):
    stream = io.StringIO()
    progress = Progress("reading", "bytes", stream=stream, clock=clock)
    clock.now += PLAIN_S
    progress.at(0)
    clock.now += PLAIN_S
    progress.at(4200)
    assert stream.getvalue() == "reading, 5 s\nreading: 4,200 bytes, 10 s\n"


def test_a_line_of_progress_is_erased_also_after_an_error(clock):
    stream = Terminal()

    def work():
        with Progress("writing", "bytes", stream=stream, clock=clock) as progress:
            clock.now += SOON_S
            progress.at(7, 14)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert stream.getvalue() == "\rwriting: 7 of 14 bytes (50 %), 0 s\x1b[K\r\x1b[K"


def test_columns_are_as_wide_as_their_widest_cell_and_numbers_stand_right():
    table = Table(("name", "value"))
    table.add(("left", "-1.5"))
    table.add(("right_drive", "100.25"))
    assert table.lines() == ["name         value", "left           -1.5", "right_drive  100.25"]


def test_what_is_printed_is_json_with_the_keys_of_the_messages():
    text = json_text({"joints": [JointReading("é", math.nan)]})
    assert text.isascii()
    assert text.startswith('{\n  "joints"')
    (joint,) = json.loads(text)["joints"]
    assert (joint["name"], joint["position"]) == ("é", None)


@pytest.mark.parametrize("name", ["a", "é"])
def test_a_line_of_a_stream_is_compact(name):
    text = json_line([JointReading(name, math.inf)])
    assert text.startswith('[{"name":"')
    assert text.isascii()
    assert (json.loads(text)[0]["name"], json.loads(text)[0]["position"]) == (name, None)


def test_progress_may_report_speed_and_the_time_that_is_left():
    now, stream = [0.0], io.StringIO()
    progress = Progress("loading", "bytes", stream=stream, clock=lambda: now[0], rate=True)
    now[0] = 10.0
    progress.at(0, 4000)
    now[0] = 20.0
    progress.at(1000, 4000)
    assert stream.getvalue().splitlines() == [
        "loading: 0 of 4,000 bytes (0 %), 10 s",
        "loading: 1,000 of 4,000 bytes (25 %), 20 s, 100 bytes/s, 30 s left",
    ]


def test_the_speed_is_that_of_the_transfer_under_way():
    now, stream = [0.0], io.StringIO()
    progress = Progress("loading", "bytes", stream=stream, clock=lambda: now[0], rate=True)
    for now[0], done in ((1.0, 0), (2.0, 3000), (3.0, 500), (10.0, 2250)):  # it broke off, and was started again
        progress.at(done, 4000)
    assert stream.getvalue().splitlines()[-1].endswith("10 s, 250 bytes/s, 7 s left")
