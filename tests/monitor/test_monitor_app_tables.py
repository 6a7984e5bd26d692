import asyncio

from textual.app import App

from canopen_control.frame import CanFrame
from canopen_control.monitor.frame_tables import FrameTable
from canopen_control.monitor.monitor_app import FRAME_COLUMNS, TONE_STYLES, LiveTable, frame_rows
from canopen_control.monitor.monitor_content import Cell, Tone
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription


class Screen(App):
    def compose(self):
        self.table = LiveTable(("name", "state"))
        yield self.table


def on_screen(check):
    async def run():
        app = Screen()
        async with app.run_test() as pilot:
            await pilot.pause()
            check(app.table)

    asyncio.run(run())


def row(name, state="up", tone=Tone.PLAIN):
    return (Cell(name), Cell(state, tone))


def test_only_changed_cells_are_written():
    def check(table):
        rows = {"a": row("a"), "b": row("b")}
        table.show(rows)
        assert table.written == 4
        table.show(dict(rows))
        assert table.written == 4
        table.show({**rows, "b": row("b", "down", Tone.BAD)})
        assert table.written == 5
        assert str(table.get_cell("b", "state")) == "✖ down"
        assert str(table.get_cell("b", "state").style) == TONE_STYLES[Tone.BAD]

    on_screen(check)


def test_rows_come_and_go_and_the_cursor_tells_which_is_meant():
    def check(table):
        assert table.selected is None
        table.show({"a": row("a"), "b": row("b")})
        assert table.selected == "a"
        table.show({"b": row("b")})
        assert table.row_count == 1
        assert table.selected == "b"

    on_screen(check)


def test_a_row_for_each_identifier_by_identifier():
    table, decoder = FrameTable(), Decoder(NetworkDescription())
    for at, can_id in enumerate((0x703, 0x080, 0x703)):
        table.add(decoder.decode(CanFrame(can_id, b"\x05" if can_id == 0x703 else b""), at * 10_000_000))
    rows = frame_rows(table)
    assert list(rows) == [str(0x080), str(0x703)]
    assert [cell.text for cell in rows[str(0x703)]] == ["703", "2", "20", "node 3", "heartbeat", "05", "OPERATIONAL"]
    assert len(rows[str(0x080)]) == len(FRAME_COLUMNS)
