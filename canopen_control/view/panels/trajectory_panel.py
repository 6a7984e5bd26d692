"""Panel in which the user chooses, previews and plays a trajectory file.

A preview moves nothing: it is drawn as a transparent robot, with a table of positions. Playing requires `--teleop`.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.health import BAD, GOOD
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.view.elements.nicegui_elements import Feed, FileUpload, PresenceElement
from canopen_control.view.panels.panel import Html
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.scene_tree import angles_of
from canopen_control.view.trajectory_player import (
    MAX_BYTES,
    active_trajectory_controllers,
    load,
    place_text,
    preview_table,
    progress_of,
)
from canopen_control.view.words import sentence

if TYPE_CHECKING:
    from nicegui.events import UploadEventArguments

    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext
    from canopen_control.view.trajectory_player import LoadedTrajectory


_TOO_LONG: Final = (
    f"the file must have at most {MAX_BYTES} bytes; play longer files with canopen-control trajectory play"
)
_READ_ONLY: Final = "<p class='cc-note'>To play, start <code>canopen-control view --teleop</code></p>"


class TrajectoryPanel:
    """Panel that previews and plays a trajectory; visible while a trajectory controller is active or playing."""

    def __init__(self, context: PanelContext) -> None:
        self._context, self._client = context, ui.context.client
        self._frame = ui.context.slot.parent
        self._loaded: LoadedTrajectory | None = None
        self._now: dict[str, float | None] = {}
        self._playing: str | None = None
        self._controllers: list[str] = []
        self._build()
        self._frame.visible = False

    def _build(self) -> None:
        page = self._client.id
        self._upload = FileUpload("Choose a file: YAML or JSON", self._take, lambda: self._refuse(_TOO_LONG), MAX_BYTES)
        self._upload.props("accept='.yaml,.yml,.json'")
        self._choice = ui.select([], label="controller").props("dense").style("width: 100%")
        with ui.element("div") as self._preview:
            with ui.element("div").classes("cc-slider cc-scrub"):
                ui.label("point")
                self._slider = ui.slider(min=0, max=1, step=1, value=0, on_change=self._scrub)
                self._slider.props('dense aria-label="preview"')
                self._time = ui.label()
            self._place, self._table = Html("cc-note"), Html()
            with ui.element("div").classes("cc-row cc-acts"):
                self._play = ui.button("Play", color="green-8", on_click=self._play_it).props("unelevated")
                self._cancel = ui.button(
                    "Cancel", color="blue-grey-8", on_click=lambda: self._context.player.cancel(page)
                ).props("unelevated")
                self._close = ui.button("Close preview", color="blue-grey-6", on_click=self._forget).props("outline")
            if not self._context.teleop:
                ui.html(_READ_ONLY, sanitize=False)
        self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback")
        self._message = Html()
        self._feed = Feed()
        self._presence = PresenceElement(lambda: self._context.player.here(page))
        self._arrange()

    def show(self, content: PageContent) -> None:
        if content.lost:
            return
        self._follow_controllers(active_trajectory_controllers(content.controllers))
        self._now = {name: joint.position for name, joint in content.state.joints.items()}
        if self._playing is not None and self._loaded is not None:
            sample = content.state.samples_of(TrajectorySample).get(self._playing)
            self._bar.value, text = progress_of(sample, self._loaded.duration)
            self._message.show(sentence(text))
        elif self._loaded is not None:
            self._show_point()

    def _follow_controllers(self, controllers: list[str]) -> None:
        visible = bool(controllers) or self._playing is not None
        if self._frame.visible is not visible:
            self._frame.visible = visible
            if not visible:
                self._forget()
        if controllers != self._controllers:
            self._controllers = controllers
            controller = self._choice.value if self._choice.value in controllers else next(iter(controllers), None)
            self._choice.set_options(controllers, value=controller)
            self._choice.visible = len(controllers) > 1

    async def _take(self, event: UploadEventArguments) -> None:
        """Read the uploaded file and preview it, unless a trajectory is being played."""
        self._upload.reset()
        try:
            if event.file.size() > MAX_BYTES:
                raise ConfigError(_TOO_LONG)
            data = await event.file.read()
            loaded = await in_thread(partial(load, data, event.file.name))
        except ConfigError as error:
            self._refuse(str(error))
            return
        if self._playing is None:
            self._hold(loaded)

    def _refuse(self, why: str) -> None:
        self._message.show(sentence(f"Not loaded. {why}", BAD))

    def _hold(self, loaded: LoadedTrajectory | None) -> None:
        """Preview a trajectory; None ends the preview."""
        self._loaded = loaded
        self._message.show("")
        if loaded is not None:
            self._slider.props["max"] = max(1, len(loaded.points) - 1)
            self._slider.update()
            self._slider.value = 0
            self._show_point()
        self._feed_ghost()
        self._arrange()

    def _forget(self) -> None:
        if self._playing is None:
            self._hold(None)

    def _arrange(self) -> None:
        """Show the widgets for the actions that are possible now."""
        playing, loaded = self._playing is not None, self._loaded is not None
        shown = (
            (self._preview, loaded),
            (self._upload, not playing),
            (self._play, not playing and self._context.teleop),
            (self._close, not playing),
            (self._cancel, playing),
            (self._bar, playing),
        )
        for element, visible in shown:
            element.visible = visible
        self._slider.set_enabled(not playing)
        self._presence.switch(on=playing)

    def _number(self) -> int:
        last = len(self._loaded.points) - 1 if self._loaded is not None else 0
        return min(max(int(self._slider.value or 0), 0), last)

    def _scrub(self, _event: Any) -> None:  # noqa: ANN401 - what a browser sends
        if self._playing is None:
            self._show_point()
            self._feed_ghost()

    def _show_point(self) -> None:
        loaded, number = self._loaded, self._number()
        if loaded is None:
            return
        self._time.text = f"{loaded.points[number].time_from_start:.2f} s"
        self._place.show(sentence(f"{loaded.name}. {place_text(loaded, number)}."))
        self._table.show(preview_table(loaded, number, self._now, self._context.robot.linear))

    def _feed_ghost(self) -> None:
        """Draw the previewed point as a transparent robot; other joints are drawn at their current positions."""
        positions = self._loaded.positions(self._number()) if self._loaded is not None and self._playing is None else {}
        angles = angles_of(self._context.robot.model, {**self._now, **positions}) if positions else None
        self._feed.send({"ghost": angles})

    async def _play_it(self) -> None:
        loaded, controller = self._loaded, self._choice.value
        if loaded is None or controller is None or self._playing is not None:
            return
        self._playing = str(controller)
        self._begin_or_end()
        played = await self._context.player.play(self._client.id, self._playing, loaded)
        self._playing = None
        with self._client:
            self._begin_or_end()
            self._message.show(sentence(played.text, GOOD if played.reached else BAD))

    def _begin_or_end(self) -> None:
        self._bar.value = 0.0
        self._table.show("")
        self._place.show("")
        self._message.show("")
        self._feed_ghost()
        self._arrange()
