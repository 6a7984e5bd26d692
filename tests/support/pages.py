"""Pages without a browser: what a robot says as the wire has it, and panels built for a simulated user."""

import asyncio
import contextlib
import copy
import threading
import time
import warnings

from support.host import TIMEOUT_S
from support.samples import controllers_of, sample_of, status_of

from canopen_control.commissioning.node_session import NodeSession
from canopen_control.rpc.messages.drive import FaultListing
from canopen_control.rpc.messages.robot import BusPlace, Description, NodeListing, NodePlace
from canopen_control.view.page_content import DriveFaults
from canopen_control.view.robot_connection import read_robot_info
from canopen_control.view.robot_view import NodeJobs, RobotView
from canopen_control.view.trajectory_player import TrajectoryPlayer

URDF = """<robot name='pair'><link name='base'><visual><geometry><box size='0.4 0.3 0.1'/></geometry></visual></link>
<link name='wheel'><visual><geometry><cylinder radius='0.1' length='0.04'/></geometry></visual></link>
<link name='fork'/>
<joint name='left' type='continuous'><parent link='base'/><child link='wheel'/><axis xyz='0 1 0'/></joint>
<joint name='lift' type='prismatic'><parent link='base'/><child link='fork'/><axis xyz='0 0 1'/>
<limit lower='0' upper='0.5' velocity='0.2' effort='9'/></joint></robot>"""
AXIS = {"joint": "left", "cia402_state": "OPERATION_ENABLED", "mode": "PV", "error": None}
NODE = {"node_id": 3, "ready": True, "nmt_state": "OPERATIONAL", "age_s": 0.01, "error": None, "axes": [AXIS]}
STATE = {
    "time": 1000.0, "state": "running", "latched": False, "latched_by": None,
    "cycle": {"period_s": 0.02, "count": 50, "missed": 0, "work_s": 0.001},
    "nodes": {"left_drive": NODE},
    "joints": {"left": {"position": 1.0, "velocity": 2.0, "effort": None, "command": 2.5},
               "lift": {"position": 0.1, "velocity": 0.0, "effort": None, "command": None}},
    "controllers": {"forward": "active", "base": "inactive"}, "load": {"can": 0.021}, "samples": {},
}  # fmt: skip
FORWARD = {"name": "forward", "type": "f", "state": "active", "interface": "velocity", "topic": "commands",
           "joints": ["left"], "claimed_interfaces": ["left/velocity"]}  # fmt: skip
BASE = FORWARD | {"name": "base", "state": "inactive", "topic": "cmd_vel", "claimed_interfaces": []}
LIFT = FORWARD | {
    "name": "lifter",
    "interface": "position",
    "joints": ["lift"],
    "claimed_interfaces": ["lift/position"],
}
ARM = FORWARD | {"name": "arm", "topic": "joint_trajectory", "interface": "position", "joints": ["left", "lift"],
                 "tells": "trajectory", "claimed_interfaces": ["left/position", "lift/position"]}  # fmt: skip
TARGET = FORWARD | {"name": "left", "interface": "target", "topic": "target", "claimed_interfaces": ["left/target"]}
FAULTS = (
    FaultListing(name="silent", does="is silent", reaction="stops", on=True),
    FaultListing(name="hot", does="is hot", reaction="waits", once=True),
)
IDLE_TURNS = 20  # of the loop: more than any handler needs to begin what it does, and to go on when a thread has ended


def state(**changed):
    return sample_of(copy.deepcopy(STATE) | changed)


def drive_state(axis=None, **node):
    """Return the state with its drive changed."""
    return state(nodes={"left_drive": NODE | {"axes": [AXIS | (axis or {})]} | node})


def info(**status):
    drive = NodePlace(name="left_drive", node_id=3, bus="can")
    nodes = NodeListing({"can": BusPlace("local:x")}, [drive])
    reported = copy.deepcopy(STATE) | {"buses": {"can": {"load": 0.02}}, "events": []} | status
    return read_robot_info("pair", Description(URDF, "/nowhere/pair.urdf"), nodes, status_of(reported))


def robot(**status):
    return RobotView(info(**status), lambda _content, kind: f"/mesh/1.{kind}")


class StubDesk(NodeJobs):
    """The desk of a node whose objects are those of a `stub` (support.service_node), with the dictionary `od`."""

    def __init__(self, stub, od, name="left_drive", node_id=3):
        super().__init__("pair", NodePlace(name=name, node_id=node_id, bus="can"))
        self.stub, self.od = stub, od

    def dictionary(self):
        return self.od

    @contextlib.contextmanager
    def session(self):
        yield NodeSession(self.stub, self.place.node_id, self.od, name=self.place.name, robot="pair")


class FakeContext:
    """Takes what a page asks for; `refusal` is what the robot answers."""

    def __init__(self, *, teleop=True, controllers=(FORWARD,), **status):
        self.teleop, self.refusal = teleop, None
        self.robot = robot(**status)
        self.robot.controllers = controllers_of(controllers)
        self.asked, self.held, self.let = [], [], 0
        self.player = TrajectoryPlayer(lambda page: False, print)

    async def ask(self, request):
        self.asked.append(request)
        return self.refusal

    def hold(self, page, motion, collected):
        self.held.append(motion)
        if self.refusal:
            collected(self.refusal)

    def release(self, page):
        self.let += 1

    def refresh_faults(self):
        pass

    def content(self, new=None, lost=""):
        if new is not None:
            self.robot.state = new
        return self.robot.content(lost)

    def with_faults(self):
        self.robot.faults = DriveFaults({"left_drive": FAULTS})
        return self


@contextlib.asynccontextmanager
async def visited(build, context=None):
    """Build a page for a simulated user, show it the content of a `context`, and yield the user and the page."""
    from nicegui.testing.user_simulation import user_simulation

    created = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warning of the toolkit
        async with user_simulation(root=lambda: created.append(build())) as user:
            await user.open("/")
            with user:
                if context is not None:
                    created[0].show(context.content())
                yield user, created[0]
            for _ in range(IDLE_TURNS):  # asyncio before 3.12 loses a cancellation that meets an update on its way out,
                await asyncio.sleep(0)  # and the toolkit would wait two seconds for that task


async def expect_seen(user, words):
    """Fail unless these words are on the page, or come soon."""
    await user.should_see(words, retries=round(10 * TIMEOUT_S))  # tenths of a second


def html(user):
    """Return all HTML that is on the page."""
    from nicegui import ElementFilter, ui

    with user._client:
        return " ".join(element.content for element in ElementFilter(kind=ui.html))


def seen(kind):
    """Return a page's elements of a kind that are visible."""
    from nicegui import ElementFilter

    return [element for element in ElementFilter(kind=kind) if element.visible]


async def upload(user, name, data, until=None):
    """Choose a file in the page's only upload that is seen; wait `until`, or until the page has said what it is."""
    from nicegui import ui
    from nicegui.elements.upload_files import SmallFileUpload

    await seen(ui.upload)[0].handle_uploads([SmallFileUpload(name, "", data)])
    await settle(until or (lambda: f"{name}: " in html(user) or f". {name}" in html(user)))


async def settle(condition):
    """Let the loop run until `condition`, however long a busy machine takes for it."""
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end, "not within the time"
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(0.01)


async def at_rest():
    """Let the loop run until the page has nothing more to do, neither here nor on a thread."""
    turns, end = 0, time.monotonic() + TIMEOUT_S
    while turns < IDLE_TURNS:
        assert time.monotonic() < end, "not within the time"
        turns = 0 if "page" in [thread.name for thread in threading.enumerate()] else turns + 1
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(0 if turns else 0.001)
