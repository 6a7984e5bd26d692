import contextlib
import html
import re
import threading

import pytest
from rich.style import Style
from textual.app import App

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.commissioning.jobs import JOBS
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.frame import CanFrame
from canopen_control.monitor.drive_objects import OBJECT_COLUMNS
from canopen_control.monitor.frame_tables import FrameTable, TraceLog
from canopen_control.monitor.monitor_app import (
    FRAME_COLUMNS,
    MARK_STYLES,
    PERIOD_S,
    SET,
    TONE_STYLES,
    DrivePane,
    LiveTable,
    MonitorApp,
    frame_rows,
    tone_styles,
)
from canopen_control.monitor.monitor_content import (
    DRIVE_COLUMNS,
    JOINT_COLUMNS,
    Cell,
    LogLine,
    MonitorContent,
    Tone,
    age_cell,
    sdo_cell,
    state_cell,
)
from canopen_control.rpc.messages.robot import AxisRequest, Release, Stop
from canopen_control.trace.decoder import Decoder, Mark
from canopen_control.trace.network_description import NetworkDescription, NodeDescription
from canopen_control.trace.values import statusword_text


class Screen(App):
    def compose(self):
        self.table = LiveTable(("name", "state"))
        yield self.table


@contextlib.asynccontextmanager
async def table_on_screen():
    app = Screen()
    async with app.run_test() as pilot:
        await pilot.pause()
        yield app.table


def row(name, state="up", tone=Tone.PLAIN):
    return (Cell(name), Cell(state, tone))


async def test_only_changed_cells_are_written():
    async with table_on_screen() as table:
        rows = {"a": row("a"), "b": row("b")}
        table.show(rows)
        assert table.written == 4
        table.show(dict(rows))
        assert table.written == 4
        table.show({**rows, "b": row("b", "down", Tone.BAD)})
        assert table.written == 5
        assert str(table.get_cell("b", "state")) == "✖ down"
        assert str(table.get_cell("b", "state").style) == TONE_STYLES[Tone.BAD]


async def test_rows_appear_and_disappear_and_the_cursor_reports_which_is_meant():
    async with table_on_screen() as table:
        assert table.selected is None
        table.show({"a": row("a"), "b": row("b")})
        assert table.selected == "a"
        table.show({"b": row("b")})
        assert table.row_count == 1
        assert table.selected == "b"


def test_a_row_for_each_identifier_by_identifier():
    table, decoder = FrameTable(), Decoder(NetworkDescription())
    for at, can_id in enumerate((0x703, 0x080, 0x703)):
        table.add(decoder.decode(CanFrame(can_id, b"\x05" if can_id == 0x703 else b""), at * 10_000_000))
    rows = frame_rows(table)
    assert list(rows) == [str(0x080), str(0x703)]
    assert [cell.text for cell in rows[str(0x703)]] == ["703", "2", "20", "node 3", "heartbeat", "05", "OPERATIONAL"]
    assert len(rows[str(0x080)]) == len(FRAME_COLUMNS)


def test_every_tone_and_every_mark_has_a_valid_rich_style():
    assert set(TONE_STYLES) == set(Tone)
    assert set(MARK_STYLES) == set(Mark)
    for style in [*TONE_STYLES.values(), *MARK_STYLES.values()]:
        Style.parse(style)


def test_no_color_leaves_no_colour_and_bad_still_stands_out():
    plain = tone_styles({"NO_COLOR": "1"})
    assert set(plain) == set(Tone)
    assert all(Style.parse(style).color is None for style in plain.values())
    assert plain[Tone.BAD] not in {style for tone, style in plain.items() if tone is not Tone.BAD}
    assert Style.parse(tone_styles({})[Tone.BAD]).color is not None


class Alone(App):
    def __init__(self):
        super().__init__()
        self.pane = DrivePane()

    def compose(self):
        yield self.pane


async def test_it_offers_the_write_of_an_object_and_every_verb():
    app = Alone()
    async with app.run_test() as pilot:
        app.pane.choose()
        await pilot.pause()
        offered = [app.pane.choice.get_option_at_index(at) for at in range(app.pane.choice.option_count)]
        assert [item.id for item in offered] == [SET, *JOBS]
        assert all(str(item.prompt).startswith(item.id) for item in offered)
        app.pane.choice.highlighted = 3
        app.pane.choose()
        assert app.pane.choice.highlighted == 0  # the first one again


async def test_without_a_verb_there_is_nothing_to_end_or_to_show():
    app = Alone()
    async with app.run_test():
        app.pane.end()
        app.pane.close()
        app.pane.show_work()
        app.pane.show(None)
        assert not app.pane.busy
        assert str(app.pane.title.content) == "listening only: reading objects would require sending"


class FakeSource:
    """A robot of two drives that notes what it is asked."""

    def __init__(self, *, can_command=True):
        self.can_command = can_command
        self.network = NetworkDescription(nodes={3: NodeDescription("left", 3)})
        self.frames, self.trace, self.taps = FrameTable(), TraceLog(), []
        self.asked, self.refusal, self.hold = [], None, None
        self.lines, self.emergency_lines = [], []
        self.rows = None
        self.objects, self.chosen = None, ""
        self.alarm, self.state = "", Cell("OPERATION ENABLED", Tone.GOOD)
        self.decoder, self.started, self.closed = Decoder(self.network), False, False

    def start(self, on_sample):
        self.started, self.news = True, on_sample

    def listen(self, wanted):
        self.listening = wanted

    def close(self):
        self.closed = True

    def tick(self):
        pass

    def content(self):
        drives = {
            name: (Cell(name), Cell("OPERATIONAL"), self.state, *[Cell("-")] * (len(DRIVE_COLUMNS) - 3))
            for name in ("left", "right")
        }
        joints = {"wheel": tuple(Cell("1.000") for _ in JOINT_COLUMNS)}
        drives = drives if self.rows is None else self.rows
        return MonitorContent("robby", Cell("running", Tone.GOOD), self.alarm, ("cycle 20 ms",), drives, joints)

    def choose(self, node):
        self.chosen = node
        return self.objects

    def log(self):
        lines, self.lines = self.lines, []
        return lines

    def emergencies(self):
        lines, self.emergency_lines = self.emergency_lines, []
        return lines

    def command(self, request):
        if self.hold is not None and not isinstance(request, Stop):
            self.hold.wait(60)
        self.asked.append(request)
        if self.refusal:
            raise RemoteError("ControlError", self.refusal)

    def begin(self, what, text, node):
        if self.refusal:
            raise ConfigError(self.refusal)
        self.run = Run([what, text, node])
        return self.run

    def hear(self, can_id, data):
        decoded = self.decoder.decode(CanFrame(can_id, bytes(data)), 0)
        self.frames.add(decoded)
        self.trace.add(decoded)


class Run:
    """A verb that runs as long as a test wants it."""

    def __init__(self, words):
        self.title, self.lines, self.code, self.ended = " ".join(words), ["begun"], None, 0

    def fresh(self):
        lines, self.lines = self.lines, []
        return lines

    def end(self):
        self.ended += 1

    close = end


@contextlib.asynccontextmanager
async def on_screen(source=None, size=(120, 36)):
    source = source or FakeSource()
    app = MonitorApp(source)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        yield app, pilot, source


async def asked(pilot, source, count=1):
    """Wait for what keys have asked for."""
    for _ in range(200):
        if len(source.asked) >= count:
            break
        await pilot.pause(0.01)
    return source.asked


def text_of(app, name):
    return "\n".join(line.text for line in app.query_one(f"#{name}").lines)


STOP = Stop(latch=True, source="monitor")


# -- STOP


async def test_space_is_stop_and_it_is_latched():
    async with on_screen() as (_app, pilot, source):
        await pilot.press("space")
        assert await asked(pilot, source) == [STOP]


@pytest.mark.rest
@pytest.mark.parametrize("tab", "12345")
async def test_no_widget_that_can_have_the_focus_eats_the_stop_key(tab):
    async with on_screen() as (app, pilot, source):
        await pilot.press(tab)
        count = 0
        for widget in [item for item in app.query("*") if item.focusable]:
            widget.focus()
            await pilot.pause()
            if app.focused is not widget:
                continue
            await pilot.press("space")
            count += 1
            assert len(await asked(pilot, source, count)) == count, widget
        assert count >= 3
        assert set(map(str, source.asked)) == {str(STOP)}


@pytest.mark.rest
async def test_stop_works_while_a_filter_is_typed_and_leaves_the_text_alone():
    async with on_screen() as (app, pilot, source):
        await pilot.press("slash", "h", "b", "space")
        assert await asked(pilot, source) == [STOP]
        assert app.query_one("#filter").value == "hb"


@pytest.mark.rest
async def test_stop_does_not_wait_for_what_else_was_asked():
    source = FakeSource()
    source.hold = threading.Event()
    async with on_screen(source) as (_app, pilot, source):
        await pilot.press(*"eeeeeeeeee", "space")
        assert (await asked(pilot, source))[0] == STOP
        source.hold.set()


async def test_a_refusal_is_reported_as_it_is():
    source = FakeSource()
    source.refusal = "axis enable is refused [latched]: STOP"
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("e")
        await asked(pilot, source)
        for _ in range(100):
            app.refresh_picture()
            if app._notifications:
                break
            await pilot.pause(0.01)
        (reported,) = app._notifications
        assert reported.message == "enable left: axis enable is refused [latched]: STOP"
        assert reported.severity == "error"


# -- the other keys


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("r", Release(source="monitor")),
        ("e", AxisRequest(action="enable", node="left", source="monitor")),
        ("d", AxisRequest(action="disable", node="left", source="monitor")),
        ("f", AxisRequest(action="fault-reset", node="left", source="monitor")),
        (["down", "f"], AxisRequest(action="fault-reset", node="right", source="monitor")),
        ("E", AxisRequest(action="enable", node="all", source="monitor")),
        ("D", AxisRequest(action="disable", node="all", source="monitor")),
        ("F", AxisRequest(action="fault-reset", node="all", source="monitor")),
    ],
)
async def test_keys_ask_the_robot(keys, expected):
    async with on_screen() as (_app, pilot, source):
        await pilot.press(*keys)
        assert await asked(pilot, source) == [expected]


@pytest.mark.rest
async def test_a_click_selects_a_drive():
    async with on_screen() as (_app, pilot, source):
        await pilot.click("#drives", offset=(5, 2))
        await pilot.press("e")
        assert await asked(pilot, source) == [AxisRequest(action="enable", node="right", source="monitor")]


async def test_a_listen_only_port_sends_no_request_and_reports_why():
    source = FakeSource(can_command=False)
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("space", "e", "r", "f", "E")
        await pilot.pause(0.1)
        assert source.asked == []
        assert [notification.message for notification in app._notifications] == [
            "listening only: this monitor sends nothing, so it cannot stop anything"
        ]
        assert "Enable" not in {
            item.binding.description for item in app.screen.active_bindings.values() if item.enabled
        }


# -- what is shown


async def test_the_head_and_an_alarm():
    async with on_screen() as (app, pilot, source):
        assert str(app.query_one("#head").content) == "robby  ● running  cycle 20 ms"
        assert not app.query_one("#alarm").display
        source.alarm = "STOP is latched by somebody"
        app.refresh_picture()
        await pilot.pause()
        assert app.query_one("#alarm").display
        assert str(app.query_one("#alarm").content) == "STOP is latched by somebody"


async def test_only_what_changed_is_drawn_again():
    async with on_screen() as (app, _pilot, source):
        drives = app.query_one("#drives")
        before = drives.written
        app.refresh_picture()
        assert drives.written == before
        source.state = Cell("FAULT", Tone.BAD)
        app.refresh_picture()
        assert drives.written == before + 2
        assert str(drives.get_cell("left", "CiA 402")) == "✖ FAULT"


@pytest.mark.rest
async def test_events_and_emergencies_have_logs_of_their_own():
    async with on_screen() as (app, pilot, source):
        source.lines = [LogLine(1.5, "robby runs"), LogLine(2.0, "left: fault [1]", Tone.BAD)]
        source.emergency_lines = [LogLine(2.0, "left: EMCY 0x3210", Tone.BAD)]
        app.refresh_picture()
        await pilot.pause()
        assert "  robby runs" in text_of(app, "events")
        assert "✖ left: fault [1]" in text_of(app, "events")
        await pilot.press("2")
        await pilot.pause()
        assert "✖ left: EMCY 0x3210" in text_of(app, "emergencies")


@pytest.mark.rest
async def test_identifiers_are_a_table_and_are_at_standstill_when_paused():
    async with on_screen() as (app, pilot, source):
        source.hear(0x703, [5])
        await pilot.press("3")
        app.refresh_picture()
        table = app.query_one("#identifiers-table")
        assert table.row_count == 1
        await pilot.press("p")
        source.hear(0x702, [5])
        app.refresh_picture()
        assert table.row_count == 1
        await pilot.press("p")
        app.refresh_picture()
        assert table.row_count == 2


async def test_the_trace_follows_its_filter():
    async with on_screen() as (app, pilot, source):
        source.hear(0x703, [5])
        source.hear(0x000, [1, 0])
        await pilot.press("4")
        app.refresh_picture()
        await pilot.pause()
        assert "left" in text_of(app, "trace")
        assert "START, all nodes" in text_of(app, "trace")
        await pilot.press("slash", *"nmt", "enter")
        app.refresh_picture()
        await pilot.pause()
        assert "START, all nodes" in text_of(app, "trace")
        assert "heartbeat" not in text_of(app, "trace")
        assert app.focused is app.query_one("#drives")


@pytest.mark.rest
async def test_a_wrong_filter_is_reported_and_can_be_repaired():
    async with on_screen() as (app, pilot, _source):
        await pilot.press("slash", "x", "x", "enter")
        await pilot.pause()
        assert "no node 'xx'" in next(iter(app._notifications)).message
        assert app.focused is app.query_one("#filter")
        await pilot.press("escape")
        assert not app.query_one("#filter").display


@pytest.mark.rest
async def test_a_flood_is_reported_instead_of_drawn():
    async with on_screen() as (app, pilot, source):
        await pilot.press("4")
        await pilot.pause()
        for _ in range(500):
            source.hear(0x703, [5])
        app.refresh_picture()
        await pilot.pause()
        assert "... 440 frames not shown; / filters" in text_of(app, "trace")
        assert len(app.query_one("#trace").lines) < 100


@pytest.mark.rest
async def test_the_drives_of_an_arm_fit_120_columns():
    source = FakeSource()
    source.rows = {
        name: (
            Cell(f"{name} (2)"),
            Cell("OPERATIONAL", Tone.GOOD),
            state_cell(State.OPERATION_ENABLED.name),
            Cell("CSP"),
            age_cell(0.012, stale=1, dead=2),
            sdo_cell(159, 28, 0),
            Cell(""),
            Cell(statusword_text(0x1237, OperationMode.CSP).replace("OPERATION ENABLED, ", "")),
        )
        for name in ("joint_1_drive", "joint_2_drive")
    }
    async with on_screen(source) as (app, _pilot, source):
        table = app.query_one("#drives")
        assert table.row_count == 2
        assert table.virtual_size.width <= table.size.width == 120
        assert table.max_scroll_x == 0


@pytest.mark.rest
async def test_a_robot_without_drives_has_no_table_of_them_until_it_has():
    source = FakeSource()
    drives, source.rows = source.content().drives, {}
    async with on_screen(source) as (app, pilot, source):
        assert not app.query_one("#drives").display
        source.rows = drives
        app.refresh_picture()
        await pilot.pause()
        assert app.query_one("#drives").display
        assert app.focused is app.query_one("#drives")  # so that the arrow keys select one
        await pilot.press("down", "e")
        assert await asked(pilot, source) == [AxisRequest(action="enable", node="right", source="monitor")]


async def test_its_picture_loads_no_external_resource():
    async with on_screen() as (app, _pilot, _source):
        assert "url(" in app.export_screenshot()  # what is taken out was there
        picture = app.picture_svg()
        assert "url(" not in picture.replace("url(#", "")
        assert "@font-face" not in picture
        assert "OPERATIONAL" in picture


# -- when it draws


async def test_a_new_sample_is_drawn_when_it_comes():
    async with on_screen() as (app, pilot, source):
        drawn = app._drawn
        source.lines = [LogLine(1.0, "a drive was lost", Tone.BAD)]
        threading.Thread(target=source.news).start()  # as the robot's connection does
        for _ in range(200):
            if app._drawn != drawn:
                break
            await pilot.pause(0.005)
        assert "a drive was lost" in text_of(app, "events")


@pytest.mark.rest
async def test_frames_are_received_only_while_they_are_displayed():
    async with on_screen() as (app, pilot, source):
        app.refresh_picture()
        expected = [source.listening]
        for key in ("3", "4", "1"):
            await pilot.press(key)
            app.refresh_picture()
            expected.append(source.listening)
        assert expected == [False, True, True, False]


@pytest.mark.rest
async def test_a_changing_number_does_not_have_the_screen_laid_out_again(monkeypatch):
    async with on_screen() as (app, pilot, source):
        app.refresh_picture()
        await pilot.pause()
        laid_out = []
        monkeypatch.setattr(app.screen, "_refresh_layout", lambda *_, **__: laid_out.append(1))
        for text, expected in (("OPERATION ENABLE", False), ("QUICK STOP ACTIVE AND LONGER", True), ("FAULT", True)):
            laid_out.clear()
            source.state = Cell(text, Tone.BAD)
            app.refresh_picture()
            await pilot.pause()
            assert bool(laid_out) is expected


# -- a small terminal


@pytest.mark.rest
async def test_on_80_columns_and_24_lines_the_errors_and_the_remedy_are_in_sight():
    """What tmux, a serial console and an old laptop have: the error of a drive, and how to quit."""
    async with on_screen(size=(80, 24)) as (app, pilot, source):
        drive = dict(zip(DRIVE_COLUMNS, ("right_drive (2)", "● OPERATIONAL", "● OPERATION ENABLED"), strict=False))
        drive |= {"error": "EMCY 0x3220 (DC link under-voltage)"}
        source.rows = {"right": tuple(Cell(drive.get(title, "-")) for title in DRIVE_COLUMNS)}
        shown = ""
        for _ in range(200):  # a busy machine draws late
            await pilot.pause(PERIOD_S)
            shown = html.unescape(app.picture_svg()).replace("\xa0", " ")
            if "EMCY 0x3220" in shown:
                break
        assert "EMCY 0x3220" in shown
        for key in ("STOP", "Quit", "Release", "Enable", "Disable", "Reset", "Filter", "Pause"):
            assert key in shown, key


# -- the objects of the selected drive


class FakeObjects:
    """The objects of a drive, of which `looked` are in sight."""

    def __init__(self):
        self.looked, self.left, self.words, self.title = [], 0, None, "left, node 3"

    def rows(self):
        return {f"0x{index:04X}:00": tuple(Cell(str(index)) for _ in OBJECT_COLUMNS) for index in range(0x2000, 0x2100)}

    def watch(self, addresses):
        self.looked = list(addresses)

    def leave(self):
        self.left += 1

    def search(self, words):
        if words == "flux":
            raise ConfigError("no object 'flux' in the EDS")
        self.words = words


async def test_the_objects_of_the_selected_drive_are_read_while_their_tab_is_open():
    source = FakeSource()
    source.objects = FakeObjects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("down", "5")
        app.refresh_picture()
        await pilot.pause()
        app.refresh_picture()
        assert source.chosen == "right"
        assert "left, node 3" in str(app._drive.title.content)
        assert source.objects.looked[:2] == ["0x2000:00", "0x2001:00"]
        assert len(source.objects.looked) < 100  # what is in sight, and no more
        await pilot.press("1")
        app.refresh_picture()
        assert source.objects.left == 1


@pytest.mark.rest
async def test_a_search_of_objects_is_typed_like_a_filter_and_an_error_is_reported():
    source = FakeSource()
    source.objects = FakeObjects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("5")
        app.refresh_picture()
        await pilot.press("slash", *"flux", "enter")
        await pilot.pause()
        assert [notification.message for notification in app._notifications] == ["no object 'flux' in the EDS"]
        app.query_one("#filter").value = "velocity"
        await pilot.press("enter")
        await pilot.pause()
        assert source.objects.words == "velocity"
        assert app.query_one("#tabs").active == "tab-drive"


# -- the work at a drive


class Objects(FakeObjects):
    """One object, which is edited."""

    def __init__(self):
        super().__init__()
        self.written, self.undone = [], 0

    def rows(self):
        return {"0x6081:00": tuple(Cell("-") for _ in OBJECT_COLUMNS)}

    def write(self, text):
        self.written.append(text)
        return "1000 -> 2500"

    def undo(self):
        self.undone += 1
        return "2500 -> 1000"


def typed(text):
    return [{"=": "equals_sign", ".": "full_stop", "-": "minus", ",": "comma"}.get(item, item) for item in text]


async def collected(pilot, app):
    """Wait for what a thread has to say."""
    for _ in range(200):
        app.refresh_picture()
        await pilot.pause(0.01)
        if app._notifications:
            break
    return [notification.message for notification in app._notifications]


@pytest.mark.rest
async def test_what_may_be_done_with_a_drive_is_chosen_and_filled_in():
    source = FakeSource()
    source.objects = Objects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("down", "w")
        app.refresh_picture()
        assert app.query_one("#works").display
        await pilot.press("down", "down", "down", "down", "enter")
        await pilot.pause()
        assert app.query_one("#filter").placeholder == "FILE.dcf"
        assert not app.query_one("#works").display
        await pilot.press(*typed("a.dcf"), "enter")
        await pilot.pause()
        assert source.run.title == "backup a.dcf right"
        app.refresh_picture()
        await pilot.pause()
        assert text_of(app, "work").splitlines() == ["backup a.dcf right", "begun"]
        await pilot.press("x")
        assert source.run.ended == 1
        source.run.lines, source.run.code = ["134 parameters"], 0
        app.refresh_picture()
        await pilot.pause()
        assert text_of(app, "work").splitlines()[-2:] == ["134 parameters", "done"]
        source.run.code = 1
        app.refresh_picture()
        assert text_of(app, "work").count("done") == 1
    assert source.run.ended == 2  # with the monitor


@pytest.mark.rest
async def test_stop_works_while_a_line_is_filled_in():
    source = FakeSource()
    source.objects = Objects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("w", "down", "enter")
        await pilot.pause()
        await pilot.press("2", "0", "space")
        assert await asked(pilot, source) == [STOP]
        assert app.query_one("#filter").value == "20"
        await pilot.press("escape", "w", "space")
        assert await asked(pilot, source, 2) == [STOP, STOP]


@pytest.mark.rest
async def test_one_verb_runs_at_a_time_and_a_refusal_is_reported():
    source = FakeSource()
    source.objects = Objects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("w", "down", "enter", *typed("20rpm"), "enter")
        await pilot.pause()
        first = source.run
        await pilot.press("w", "down", "enter", *typed("20rpm"), "enter")
        await pilot.pause()
        assert source.run is first
        assert "a command is already running; x ends it" in [
            notification.message for notification in app._notifications
        ]
        first.code = 1
        app.refresh_picture()
        assert "ended with 1" in text_of(app, "work")
        source.refusal = "jog: no drive is selected"
        await pilot.press("enter")
        await pilot.pause()
        assert "jog: no drive is selected" in [notification.message for notification in app._notifications]
        assert app.query_one("#filter").display  # it can be mended


@pytest.mark.rest
async def test_an_object_is_written_and_the_write_is_undone():
    source = FakeSource()
    source.objects = Objects()
    async with on_screen(source) as (app, pilot, source):
        await pilot.press("5")
        app.refresh_picture()
        await pilot.pause()
        await pilot.press("w", "enter")
        await pilot.pause()
        assert app.query_one("#filter").value == "0x6081:00="
        await pilot.press(*typed("2500"), "enter")
        assert await collected(pilot, app) == ["set: 1000 -> 2500"]
        await pilot.press("u")
        for _ in range(200):
            app.refresh_picture()
            await pilot.pause(0.01)
            if len(app._notifications) == 2:
                break
        assert [notification.message for notification in app._notifications][-1] == "undo: 2500 -> 1000"
        assert (source.objects.written, source.objects.undone) == (["0x6081:00=2500"], 1)


@pytest.mark.rest
async def test_every_key_is_reached_on_a_narrow_terminal_and_the_tables_show_their_other_columns():
    async with on_screen(size=(60, 24)) as (app, pilot, _source):
        await pilot.press("question_mark")
        await pilot.pause()
        (notice,) = app._notifications
        assert notice.title == "Keys"
        named = set(re.findall(r"\w+|/", notice.message))
        keys = {"question_mark": "?", "slash": "/", "escape": "Escape"}
        for binding in MonitorApp.BINDINGS:
            key = keys.get(binding.key, binding.key)
            assert key in {*named, "?", "2", "3", "4", "ctrl+c"}, key
        await pilot.press("escape")
        assert not list(app._notifications), "Escape uncovers what the list hides"
        drives = app.query_one("#drives")
        assert drives.virtual_size.width > drives.size.width
        drives.focus()
        await pilot.press("right")
        await pilot.pause()
        assert drives.scroll_target_x > 0
