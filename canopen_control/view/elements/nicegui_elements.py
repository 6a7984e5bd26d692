"""Elements missing in NiceGUI: feed, held buttons, 3D scene, strip charts, objects, and an upload that is freed."""

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
    from canopen_control.view.scene_tree import SceneDocument
    from canopen_control.view.world_view import WorldDocument


class SceneChange(TypedDict, total=False):
    """Changes of the scene: joints by index in rad or m, pose of the base, joints with a drive in fault.

    `truth` is the true pose of a simulated base, in the frame of odometry as `pose` is.
    """

    angles: list[float | None]
    pose: list[float] | None
    truth: list[float] | None
    tint: list[str]


class PlotRows(TypedDict, total=False):
    """New rows of plots; with `anew` they replace all rows."""

    anew: bool
    rows: list[Row]


class FeedMessage(TypedDict, total=False):
    """Message of the feed; missing keys mean no change. `titles` are those of charts.

    `trail` are points in m where odometry was, `truth` where the base was. `ghost` is a place of the joints that is
    previewed, by their order in the tree, null for none; `world` is what stands beside the robot.
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
    """Invisible element: every key of the data becomes the event `cc-KEY` of the page's window."""

    def send(self, data: FeedMessage) -> None:
        """Send changed data; a message without data signals that the view is running."""
        self.run_method("take", data)


@dataclass(frozen=True, slots=True)
class HoldButton:
    """Button: its internal and its visible name, its sign, and the key of the keyboard with the same function."""

    key: str
    label: str
    sign: str = ""
    keyboard: str = ""


class HoldButtons(Element, component="hold_buttons.js"):
    """Group of buttons of which one is held at a time; calls `held(key)` and `release()`."""

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
    """Invisible element that calls `here()` periodically while it is active and the page exists."""

    def __init__(self, here: Callable[[], None]) -> None:
        super().__init__()
        self._props["on"] = False
        self._props["period"] = round(1000 / HERE_HZ)
        self.on("here", lambda _event: here(), [])

    def switch(self, *, on: bool) -> None:
        """Start or stop the periodic call."""
        if self._props["on"] is not on:
            self._props["on"] = on
            self.update()


_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"


class RobotScene(Element, component="robot_scene.js", esm={"nicegui-scene": str(_THREE)}):
    """3D scene; it receives from the feed: `scene` {"pose", "truth", "angles", "tint"}, `ghost`, a preview, and trails.

    `trail` is that of odometry, `truth` the true one of the base, if a simulation gives it.
    In a browser without WebGL a sentence appears in its place.
    """

    def __init__(self, tree: SceneDocument) -> None:
        super().__init__()
        self._props["tree"] = tree
        self.classes("cc-scene")

    def follow(self, follow: bool) -> None:
        """Keep the robot in the centre of the picture, or keep the picture fixed."""
        self.run_method("setFollow", follow)


class StripCharts(Element, component="strip_charts.js"):
    """Charts of the feed: `plots` {"rows": [[time, value, ...], ...]} by `names`, and `titles` by chart."""

    def __init__(self, charts: Sequence[Chart], names: Sequence[str], span: float) -> None:
        super().__init__()
        self._props["charts"] = [asdict(chart) for chart in charts]
        self._props["names"] = list(names)
        self._props["span"] = span
        self.classes("cc-strips")


class TreeRow(TypedDict):
    """Object in the tree: `a` is its address as text, `object` the record to which it belongs.

    `fixed` is the reason why it cannot be written by hand, else "".
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
    """Present value of an object as text, and its bits: number, name, whether set."""

    value: str | None
    meaning: str | None
    changed: bool
    error: str | None
    bits: list[tuple[int, str, bool]]


class TreeUser(Protocol):
    """Listener of a tree's events."""

    def seen(self, addresses: list[str]) -> None:
        """Process the list of visible objects."""

    def search(self, text: str) -> None:
        """Show the results of a search."""

    def write(self, address: str, text: str) -> None:
        """Write an object."""


class ObjectTree(Element, component="object_tree.js"):
    """Tree of a node's objects: constant `rows`, `writes` whether they are writable, `product` for the favourites."""

    def __init__(self, rows: Sequence[TreeRow], product: str, user: TreeUser, *, writes: bool) -> None:
        super().__init__()
        self._props["rows"] = list(rows)
        self._props["writes"] = writes
        self._props["product"] = product
        self.on("seen", lambda event: user.seen(_texts(event.args)))
        self.on("search", lambda event: user.search(str(event.args)[:_SEARCH]))
        self.on("write", lambda event: _written(event.args, user))

    def values(self, news: Mapping[str, ObjectWords]) -> None:
        """Show the values of objects."""
        self.run_method("values", dict(news))

    def matches(self, text: str, addresses: Sequence[str] | None, problem: str = "") -> None:
        """Show only the objects found by a search for `text`; all if it is None."""
        self.run_method("matches", None if addresses is None else list(addresses), problem, text)

    def answer(self, address: str, text: str, *, good: bool) -> None:
        """Show the result of writing next to the object."""
        self.run_method("answer", address, text, good)


_SEARCH = 200  # characters


def _texts(args: Any) -> list[str]:  # noqa: ANN401 - what a browser sends
    return [arg for arg in args if isinstance(arg, str)] if isinstance(args, list) else []


def _written(args: Any, user: TreeUser) -> None:  # noqa: ANN401 - what a browser sends
    if isinstance(args, dict) and isinstance(args.get("address"), str) and isinstance(args.get("text"), str):
        user.write(args["address"], args["text"])


class FileUpload(ui.upload):
    """Upload of one file, passed to `on_upload`; `refused` is called for more than `most` bytes.

    `ui.upload` makes a FastAPI route for each element, and FastAPI keeps the functions of its routes in a cache as long
    as the process lives: each page that was ever opened would stay in memory. This one makes a route of Starlette,
    which goes with the element.
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
