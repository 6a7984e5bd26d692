"""A page without a browser: viser's server on a free port, and what presses its buttons."""

import asyncio
import inspect

import pytest

pytest.importorskip("viser", reason="viser is not installed: pip install canopen-control[view]")

from canopen_control.view.door import Door
from canopen_control.view.server import PageServer, listen


class Client:
    """A page as callbacks see it: `told` is what it was shown."""

    def __init__(self, client_id=1):
        self.client_id, self.told = client_id, []

    def add_notification(self, title, text, **_how):
        self.told.append((title, text))


class Event:
    def __init__(self, target, client):
        self.target, self.client = target, client


class Hand:
    """Presses, sets and holds what is on a page, as viser's loop and threads do."""

    def __init__(self):
        self.client = Client()

    def click(self, handle):
        self._call(handle._impl.update_cb, handle)

    def choose(self, handle, value):
        handle._impl.value = value
        self._call(handle._impl.update_cb, handle)

    def hold(self, handle):
        for callbacks in handle._impl.hold_cbs_from_freq.values():
            self._call(callbacks, handle)

    def hotkey(self, command):
        self._call(command._impl.trigger_cb, command)

    def _call(self, callbacks, handle):
        for callback in callbacks:
            result = callback(Event(handle, self.client))
            if inspect.isawaitable(result):
                asyncio.run(_finish(result))


async def _finish(awaitable):
    await awaitable


@pytest.fixture
def hand():
    return Hand()


@pytest.fixture
def server():
    listener = listen("127.0.0.1", 0)
    server = PageServer(listener, Door("127.0.0.1", listener.getsockname()[1]), "test")
    yield server
    server.stop()


@pytest.fixture
def parts(server):
    """Return the handles on the page by label, the newest of each."""

    def parts():
        found = {}
        for handle in server.gui._gui_input_handle_from_uuid.values():
            found[getattr(handle._impl.props, "label", "")] = handle
        return found

    return parts
