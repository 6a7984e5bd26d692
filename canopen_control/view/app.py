"""The process of the view: `python -m canopen_control.view.app`, or `canopen-control view`.

The law of this file: two threads. The reactor's owns the connection, the dead man and everything that is drawn; the
server's only hands over what a page does, STOP apart, which it sends itself. Started by `run` it ends with its lifeline
or the robot; by hand it waits for the robot to come back. Whatever happens here, the robot does not notice.
"""

from __future__ import annotations

import signal
import sys
import threading
import traceback
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.client import select_robot
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.host.reactor import Reactor
from canopen_control.host.spawn import lifeline_fd
from canopen_control.view.door import Door
from canopen_control.view.link import Link, Welcome
from canopen_control.view.page import Page
from canopen_control.view.server import PageServer, listen
from canopen_control.view.teleop import DeadMan

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from canopen_control.host.timer import Timer
    from canopen_control.view.teleop import Motion

__all__ = ["ViewApp"]

SEEN_HZ: Final = 25.0  # samples of the state while somebody looks
UNSEEN_HZ: Final = 5.0
_RETRY_NS: Final = 500_000_000
_FAULTS_NS: Final = 3_000_000_000


class ViewApp:
    """Serves the page of the robot `name` (None: the only one) until a signal or the lifeline ends it.

    `say` prints a sentence. ConfigError when there is no such robot, or nowhere to listen.
    """

    def __init__(
        self, name: str | None, host: str, port: int | None, *, teleop: bool, say: Callable[[str], None]
    ) -> None:
        self._name, self._teleop, self._say = select_robot(name), teleop, say
        listener = listen(host, port)
        self.door = Door(host, listener.getsockname()[1])
        self._lifeline = lifeline_fd()
        self.reactor = Reactor()
        self.reactor.on_error = self._on_error
        self.server = PageServer(listener, self.door, self._name)
        self._link: Link | None = None
        self._page: Page | None = None
        self._shape: object = None
        self._controllers: object = None
        self._pages: set[int] = set()
        self._dead_man = DeadMan(self._send)
        self._letting_go: Timer | None = None
        self.server.on_client_connect(self._on_page)
        self.server.on_client_disconnect(self._on_page_closed)

    def run(self) -> None:
        """Serve until the end."""
        reactor = self.reactor
        reactor.handle_signals({signal.SIGTERM: reactor.stop, signal.SIGINT: reactor.stop})
        try:
            self.start()
            reactor.run()
        finally:
            self.close()

    def start(self) -> None:
        """Begin; the reactor does the rest."""
        if self._lifeline is not None:
            self.reactor.add_reader(self._lifeline, self.reactor.stop)
        self.reactor.call_soon(self._connect)
        self.reactor.call_later(_FAULTS_NS, self._look_for_faults)

    def close(self) -> None:
        """Let go of what is driven, and leave everything."""
        self._dead_man.let_go()
        self._leave()
        self.server.stop()
        self.reactor.close()

    # ------------------------------------------------------------------------------------ what a page may do

    def stop(self) -> None:
        """STOP, latched; RemoteError if the robot cannot be reached. From any thread."""
        link = self._link
        if link is None:
            raise RemoteError("BusClosed", f"robot {self._name} is not connected; use what else stops it")
        link.stop()

    def ask(self, method: str, params: dict[str, Any]) -> str | None:
        """Ask the robot and wait; returns the reason if it was not done. From any thread but the reactor's."""
        link = self._link
        return f"robot {self._name} is not connected" if link is None else link.ask(method, params)

    def hold(self, page: int, motion: Motion, told: Callable[[str], None]) -> None:
        """Take note that a page holds a button; from any thread."""
        self.reactor.call_threadsafe(partial(self._hold, page, motion, told))

    def _hold(self, page: int, motion: Motion, told: Callable[[str], None]) -> None:
        if page not in self._pages:
            return  # it was closed while this was on its way
        if not self._dead_man.hold(page, motion, self.reactor.now()):
            told("another page drives; it has to let go first")
        elif self._letting_go is None:
            self._watch_hold()

    def _watch_hold(self) -> None:
        """Let go in time, and look again as long as somebody holds."""
        self._dead_man.tick(self.reactor.now())
        deadline = self._dead_man.deadline
        self._letting_go = None if deadline is None else self.reactor.call_at(deadline, self._watch_hold)

    def _send(self, method: str, params: dict[str, Any]) -> None:
        if self._link is not None:
            self._link.send(method, params)

    # ------------------------------------------------------------------------------------ who looks

    async def _on_page(self, client: viser.ClientHandle) -> None:
        self.reactor.call_threadsafe(partial(self._page_opened, client.client_id))

    async def _on_page_closed(self, client: viser.ClientHandle) -> None:
        self.reactor.call_threadsafe(partial(self._page_closed, client.client_id))

    def _page_opened(self, page: int) -> None:
        self._pages.add(page)
        self._set_rate()
        self._look_at_faults()

    def _page_closed(self, page: int) -> None:
        self._pages.discard(page)
        self._dead_man.leave(page)
        self._set_rate()

    def _set_rate(self) -> None:
        if self._link is not None:
            try:
                self._link.subscribe(SEEN_HZ if self._pages else UNSEEN_HZ)
            except RemoteError as error:
                self._lost(str(error))

    def _look_for_faults(self) -> None:
        self.reactor.call_later(_FAULTS_NS, self._look_for_faults)
        if self._pages:
            self._look_at_faults()

    def _look_at_faults(self) -> None:
        """Ask the virtual drives, on a thread of its own: one of them may hang."""
        if self._page is not None:
            threading.Thread(target=self._page.faults.refresh, name="faults", daemon=True).start()

    # ------------------------------------------------------------------------------------ the robot

    def _connect(self) -> None:
        try:
            link = Link(self._name)
        except CanopenError as error:
            self._again(str(error))
            return
        try:
            welcome = link.welcome()
            self._show(welcome)
            self._link, self._controllers = link, None
            self.reactor.add_reader(link.fileno(), self._on_readable)
            self._set_rate()
        except RemoteError as error:
            self._link = link
            self._lost(str(error))
            return
        self._announce(link)
        self.reactor.call_soon(self._on_readable)  # what came with an answer makes no descriptor readable

    def _announce(self, link: Link) -> None:
        """Tell where the page is: to who started it by hand, or through the robot to who watches `run`."""
        text = f"view: {self.door.url}"
        if self._lifeline is not None:
            link.send("tell", {"kind": "view", "text": text})
        self._say(text)

    def _show(self, welcome: Welcome) -> None:
        """Make the page, unless the robot is the one that was there before."""
        shape = (welcome.urdf, welcome.nodes, sorted(welcome.status["joints"]))
        if self._page is not None and shape == self._shape:
            return
        self._shape = shape
        self.server.scene.reset()
        self.server.gui.reset()
        self._page = Page(self.server, welcome, self, teleop=self._teleop)
        for note in self._page.notes:
            self._say(note)

    def _on_readable(self) -> None:
        link, page = self._link, self._page
        if link is None or page is None:
            return
        newest = None
        try:
            for message in link.messages():
                if (state := message.get("state")) is not None:
                    newest = state
                elif (event := message.get("event")) is not None:
                    page.event(event)
            if newest is not None:
                self._follow_controllers(link, page, newest["controllers"])
                page.state(newest, seen=bool(self._pages))
        except RemoteError as error:
            self._lost(str(error))

    def _follow_controllers(self, link: Link, page: Page, told: dict[str, str]) -> None:
        if told != self._controllers:
            page.controllers(link.controllers())
            self._controllers = told

    def _lost(self, why: str) -> None:
        self._leave()
        if self._page is not None:
            self._page.lost(why)
        self._say(why)
        if self._lifeline is not None:
            self.reactor.stop()
        else:
            self._again("")

    def _again(self, why: str) -> None:
        if self._lifeline is not None and why:
            self._say(why)
            self.reactor.stop()
        else:
            self.reactor.call_later(_RETRY_NS, self._connect)

    def _leave(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            self.reactor.remove_reader(link.fileno())
            link.close()

    def _on_error(self, error: BaseException) -> None:
        """Say it and go on: a page that cannot be drawn must not take the STOP button with it."""
        self._say("".join(traceback.format_exception(error)).rstrip())


def main(name: str | None, host: str, port: int | None, *, teleop: bool) -> None:
    """Serve the page until a signal ends it; ConfigError when it cannot begin."""

    def say(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    ViewApp(name, host, port, teleop=teleop, say=say).run()
