"""Page elements that NiceGUI lacks: hold buttons, 3D scene, strip charts, object tree and others."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypedDict

import nicegui
from nicegui import app as toolkit
from nicegui import ui
from nicegui.element import Element
from nicegui.elements.upload_files import create_file_upload
from starlette.responses import PlainTextResponse

from canopen_control.view.robot_connection import HOLD_HZ
from canopen_control.view.trajectory_player import HERE_HZ

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from nicegui.events import UploadEventArguments
    from starlette.requests import Request

    from canopen_control.view.sampling import Chart, Row
    from canopen_control.view.scene_tree import SceneDocument, WorldDocument


class SceneChange(TypedDict, total=False):
    """Changes of the scene: joint positions in rad or m by index, pose of the base, and joints with a drive in fault.

    `truth` is the true pose of a simulated base, in the odometry frame like `pose`.
    """

    angles: list[float | None]
    pose: list[float] | None
    truth: list[float] | None
    tint: list[str]


class PlotRows(TypedDict, total=False):
    """New rows of the plots; with `replace` the rows replace all earlier rows."""

    replace: bool
    rows: list[Row]


class FeedMessage(TypedDict, total=False):
    """Message of the feed to a page; a missing key means "unchanged".

    `trail` are points in m of the odometry path, `truth` are points of the true path. `ghost` are the previewed
    positions of the joints by index, null for no preview; `world` are the objects around the robot; `titles` are the
    titles of the charts.
    """

    scene: SceneChange
    plots: PlotRows
    trail: list[tuple[float, float]]
    truth: list[tuple[float, float]]
    world: WorldDocument
    ghost: list[float | None] | None
    titles: dict[str, str]
    lost: bool
    latched: bool


class Feed(Element, component="feed.js"):
    """Invisible element that dispatches the event `cc-KEY` in the page's window for every key of a message."""

    def send(self, data: FeedMessage) -> None:
        """Send the changed data; an empty message shows only that the view is running."""
        self.run_method("dispatch", data)


@dataclass(frozen=True, slots=True)
class HoldButton:
    """Button of `HoldButtons`; `key` identifies the button, `keyboard` is the keyboard key with the same effect."""

    key: str
    label: str
    sign: str = ""
    keyboard: str = ""


class HoldButtons(Element, component="hold_buttons.js"):
    """Group of buttons that act while held: calls `held(key)` repeatedly, and `release()` once a button is released."""

    def __init__(
        self, buttons: Sequence[HoldButton], held: Callable[[str], None], release: Callable[[], None], kind: str = ""
    ) -> None:
        super().__init__()
        self._props["buttons"] = [asdict(button) for button in buttons]
        self._props["period"] = round(1000 / HOLD_HZ)
        self.classes(f"cc-hold {kind}")
        keys = {button.key for button in buttons}

        def on_hold(event: Any) -> None:  # noqa: ANN401 - what a browser sends
            if event.args in keys:
                held(event.args)

        self.on("hold", on_hold)
        self.on("release", lambda _event: release(), [])


class PresenceElement(Element, component="presence.js"):
    """Invisible element that calls `here()` periodically while it is switched on and the page exists."""

    def __init__(self, here: Callable[[], None]) -> None:
        super().__init__()
        self._props["on"] = False
        self._props["period"] = round(1000 / HERE_HZ)
        self.on("here", lambda _event: here(), [])

    def switch(self, *, on: bool) -> None:
        """Start or stop the periodic calls."""
        if self._props["on"] is not on:
            self._props["on"] = on
            self.update()


_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"


class RobotScene(Element, component="robot_scene.js", esm={"nicegui-scene": str(_THREE)}):
    """3D scene of the robot, updated by the fields `scene`, `ghost`, `trail` and `truth` of feed messages.

    `trail` is the path by odometry, `truth` the true path of the base, if a simulation provides it. In a browser
    without WebGL a sentence appears instead.
    """

    def __init__(self, tree: SceneDocument) -> None:
        super().__init__()
        self._props["tree"] = tree
        self.classes("cc-scene")

    def follow(self, follow: bool) -> None:
        """Keep the robot in the centre of the picture if `follow`, else leave the camera where the user placed it."""
        self.run_method("setFollow", follow)


class StripCharts(Element, component="strip_charts.js"):
    """Strip charts, updated by the `plots` and `titles` of feed messages."""

    def __init__(self, charts: Sequence[Chart], names: Sequence[str], span: float) -> None:
        super().__init__()
        self._props["charts"] = [asdict(chart) for chart in charts]
        self._props["names"] = list(names)
        self._props["span"] = span
        self.classes("cc-strips")


class TreeRow(TypedDict):
    """Static part of a row of the object tree: `a` is the address as text, `object` the name of the array or record.

    `fixed` is the reason why the user cannot write the object, or "".
    """

    a: str
    index: int
    sub: bool
    object: str
    name: str
    type: str
    access: str
    mappable: str
    unit: str
    default: str | None
    limits: str
    fixed: str


class ObjectWords(TypedDict):
    """Current value of an object as text, with named bits as number, name and state."""

    value: str | None
    meaning: str | None
    changed: bool
    error: str | None
    bits: list[tuple[int, str, bool]]


class TreeUser(Protocol):
    """Listener for the events of an `ObjectTree`."""

    def seen(self, addresses: list[str]) -> None:
        """Handle a change of the visible objects; `addresses` are the objects that are now visible."""

    def search(self, text: str) -> None:
        """Handle a change of the search text."""

    def write(self, address: str, text: str) -> None:
        """Handle the user's request to write `text` to an object."""


class ObjectTree(Element, component="object_tree.js"):
    """Tree of a node's objects; `writes` permits edits, `product` is the key under which favourites are stored."""

    def __init__(self, rows: Sequence[TreeRow], product: str, user: TreeUser, *, writes: bool) -> None:
        super().__init__()
        self._props["rows"] = list(rows)
        self._props["writes"] = writes
        self._props["product"] = product
        self.on("seen", lambda event: user.seen(_texts(event.args)))
        self.on("search", lambda event: user.search(str(event.args)[:_SEARCH]))
        self.on("write", lambda event: _written(event.args, user))

    def values(self, news: Mapping[str, ObjectWords]) -> None:
        """Update the displayed values; `news` maps addresses to values."""
        self.run_method("values", dict(news))

    def matches(self, text: str, addresses: Sequence[str] | None, problem: str = "") -> None:
        """Show only the objects at these addresses as the result of a search for `text`; None shows all objects."""
        self.run_method("matches", None if addresses is None else list(addresses), problem, text)

    def answer(self, address: str, text: str, *, good: bool) -> None:
        """Show the result of a write next to the object."""
        self.run_method("answer", address, text, good)


_SEARCH = 200  # characters


def _texts(args: Any) -> list[str]:  # noqa: ANN401 - what a browser sends
    return [arg for arg in args if isinstance(arg, str)] if isinstance(args, list) else []


def _written(args: Any, user: TreeUser) -> None:  # noqa: ANN401 - what a browser sends
    if isinstance(args, dict) and isinstance(args.get("address"), str) and isinstance(args.get("text"), str):
        user.write(args["address"], args["text"])


class FileUpload(ui.upload):
    """Upload button that passes a file to `on_upload`; `refused` is called if the file has more than `most` bytes.

    `ui.upload` adds a FastAPI route for each element, and FastAPI caches the functions of its routes for the life of
    the process, so that every page that was ever opened would stay in memory. This class adds a Starlette route, which
    is removed with the element.
    """

    def __init__(
        self, label: str, on_upload: Callable[[UploadEventArguments], Any], refused: Callable[[], Any], most: int
    ) -> None:
        super(ui.upload, self).__init__(label=label)
        self._registered_url = f"/_nicegui/client/{self.client.id}/upload/{self.id}"
        self._props["url"] = self._registered_url
        self._props["auto-upload"] = True
        self._props["max-file-size"] = most
        self._begin_upload_handlers, self._upload_handlers, self._multi_upload_handlers = [], [on_upload], []
        self.on_rejected(refused)
        self.classes("cc-upload").props("flat bordered")
        toolkit.add_route(self._registered_url, self._answer, methods=["POST"])  # `ui.upload` removes it by its path

    async def _answer(self, request: Request) -> PlainTextResponse:
        if self.is_ignoring_events:
            return PlainTextResponse("this upload is disabled or hidden", 403)
        async with request.form() as form:
            files = [await create_file_upload(field) for field in form.values() if not isinstance(field, str)]
        await self.handle_uploads(files)
        return PlainTextResponse("")
