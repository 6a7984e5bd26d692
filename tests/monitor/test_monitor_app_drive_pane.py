"""The tab of one drive, by itself."""

import asyncio

from textual.app import App

from canopen_control.monitor.drive_objects import WORKS
from canopen_control.monitor.monitor_app import SET, DrivePane


class Alone(App):
    def __init__(self):
        super().__init__()
        self.pane = DrivePane()

    def compose(self):
        yield self.pane


def test_it_offers_the_write_of_an_object_and_every_verb():
    async def check():
        app = Alone()
        async with app.run_test() as pilot:
            app.pane.choose()
            await pilot.pause()
            offered = [app.pane.choice.get_option_at_index(at) for at in range(app.pane.choice.option_count)]
            assert [each.id for each in offered] == [SET, *WORKS]
            assert all(str(each.prompt).startswith(each.id) for each in offered)
            app.pane.choice.highlighted = 3
            app.pane.choose()
            assert app.pane.choice.highlighted == 0  # the first one again

    asyncio.run(check())


def test_without_a_verb_there_is_nothing_to_end_or_to_show():
    async def check():
        app = Alone()
        async with app.run_test():
            app.pane.end()
            app.pane.close()
            app.pane.show_work()
            app.pane.show(None)
            assert not app.pane.busy
            assert str(app.pane.title.content) == "this monitor only listens: to read objects is to send"

    asyncio.run(check())
