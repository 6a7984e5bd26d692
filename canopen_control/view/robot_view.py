"""Data of one robot for all pages, with a history of the last half minute, and the jobs of its nodes, without NiceGUI.

Short requests to a node run on threads, and one long job at a time. A request has its own connection, so that STOP and
the state samples never wait behind the request. A long job continues when the page that started it is closed; every
page shows the progress, and any page can end the job.
"""

from __future__ import annotations

import contextlib
import threading
from functools import partial
from typing import TYPE_CHECKING, TypeVar, cast

from canopen_control.client import RobotClient
from canopen_control.commissioning.live_reader import LiveReader, NodeObjects
from canopen_control.errors import CanopenError, DriveError, RemoteError, RobotConfigError
from canopen_control.rpc.messages.drive import GetWorld
from canopen_control.rpc.messages.health import BAD
from canopen_control.rpc.messages.simulation import GetSimulation
from canopen_control.urdf.robot_model import RobotModel, read_model
from canopen_control.view.page_content import TIMEOUT_S, DriveFaults, PageContent, RecentEvents, VirtualDrives
from canopen_control.view.robot_connection import SOURCE, in_thread, pose_of, true_pose_of
from canopen_control.view.sampling import History, Sampler, commanded_interfaces, names
from canopen_control.view.scene_tree import SceneTree, Trail, WorldView, angles_of
from canopen_control.view.words import axis_rows

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.commissioning.jobs import JobRun
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.object_rows import Edit
    from canopen_control.commissioning.scope_run import ScopeRun
    from canopen_control.commissioning.tune_job import TuneFound
    from canopen_control.od.model import Entry
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import ControllerReading, StateSample
    from canopen_control.view.elements.nicegui_elements import SceneChange
    from canopen_control.view.robot_connection import Pose, RobotInfo


T = TypeVar("T")


class NodeJobs(NodeObjects):
    """Jobs and object edits at one node of a running robot; `history` contains the edits of all pages."""

    def __init__(
        self, robot: str, place: NodePlace, connect: Callable[[str, float], RobotClient] = RobotClient.connect
    ) -> None:
        super().__init__(robot, place, SOURCE, connect)
        self.work: JobRun | None = None
        self.scope: ScopeRun | None = None
        self.tuned: TuneFound | None = None

    async def ask(self, work: Callable[[NodeSession], T]) -> T:
        """Run `work` on a thread with a session of the node; return its result or raise its error."""
        return await in_thread(partial(self.with_session, work))

    def with_session(self, work: Callable[[NodeSession], T]) -> T:
        """Run `work` with a session of the node and return the result; blocks, so call it on a thread."""
        with self.session() as session:
            return work(session)

    # ------------------------------------------------------------------------------------ single objects

    async def write(self, entry: Entry, text: str) -> Edit:
        """Write an object from the user's text; raise CanopenError with the reason if the write is refused."""
        return await in_thread(partial(self._edit, lambda session: self.history.write(session, entry, text)))

    async def undo(self) -> Edit:
        """Undo the latest edit; raise CanopenError with the reason if it cannot be undone."""
        return await in_thread(partial(self._edit, self.history.undo))

    def _edit(self, change: Callable[[NodeSession], Edit]) -> Edit:
        if self.work is not None and self.busy:
            raise DriveError(f"{self.place.name} is busy: {self.work.title}; nothing was written")
        with self.editing:
            return self.with_session(change)

    # ------------------------------------------------------------------------------------ long jobs

    @property
    def busy(self) -> bool:
        return self.work is not None and not self.work.over

    def begin(self, work: JobRun, function: Callable[[NodeSession, JobRun], str]) -> str | None:
        """Start a job on a thread; `function` returns the final sentence. Return why the job is refused, or None."""
        if self.work is not None and self.busy:
            return f"{self.place.name} is busy: {self.work.title}; wait until this has ended"
        self.work = work
        threading.Thread(target=self._run, args=(work, function), name=f"page {work.job.name}", daemon=True).start()
        return None

    def _run(self, work: JobRun, function: Callable[[NodeSession, JobRun], str]) -> None:
        good = False
        try:
            with self.editing:
                work.sentence = self.with_session(partial(_job, function, work))
            good = not work.failed
        except CanopenError as error:
            work.sentence = str(error)
        except Exception as error:  # noqa: BLE001 - the page shows it and continues
            work.sentence = f"{work.title} ended with {type(error).__name__}: {error}"
        finally:
            work.good = good


def _job(function: Callable[[NodeSession, JobRun], str], work: JobRun, session: NodeSession) -> str:
    work.transfers = session.transfers
    try:
        return function(session, work)
    finally:
        work.transfers = None


# Disturbances in the world of a simulated robot, requested from its virtual drives by their control sockets.
#
# A robot without drives, which a simulation plugin moves, gets the request itself. A real drive has no such socket, and
# a robot with real drives refuses, so that no request can reach a real drive. Requests block for a second per drive at
# most, and are sent from threads.


class WorldClient:
    """Client for disturbances in a simulated robot's world."""

    def __init__(self, robot: str, drives: VirtualDrives) -> None:
        self._robot, self._drives = robot, drives

    def changeable(self) -> bool:
        """Whether a simulated world accepts disturbances from the robot or one of its virtual drives."""
        return self._drive() is not None or self._simulated()

    def _simulated(self) -> bool:
        """Whether the robot has no nodes, and a physics simulation that accepts disturbances moves it."""
        if self._drives.nodes:
            return False
        try:
            with RobotClient.connect(self._robot, TIMEOUT_S) as client:
                return client.ask(GetSimulation()).changeable
        except CanopenError:
            return False

    def act(self, world_act: WorldAct) -> bool:
        """Apply a disturbance; raise RemoteError if the disturbance is refused.

        Return True if the robot itself reports the disturbance as an event.
        """
        if not self._drives.nodes:
            with RobotClient.connect(self._robot, TIMEOUT_S) as client:
                client.ask(world_act)
            return True
        drive = self._drive()
        if drive is None:
            raise RemoteError(
                "BusClosed", "the robot's drives are not in a physics simulation; run the robot with --physics"
            )
        self._drives.ask(drive, world_act)
        return False

    def _drive(self) -> str | None:
        """Return any virtual drive whose simulated world accepts disturbances, or None."""
        for drive in self._drives.running():
            with contextlib.suppress(RemoteError):
                if self._drives.ask(drive, GetWorld()).changeable:
                    return drive
        return None


class RobotView:
    """Data of a robot for all pages, updated by `take`; `publish` serves a mesh as for `SceneTree`."""

    def __init__(self, info: RobotInfo, publish: Callable[[bytes, str], str]) -> None:
        self.info, self.state = info, info.state
        self.events = RecentEvents(info.events)
        self.model = _drawable(info.urdf)
        self.linear = frozenset(joint.name for joint in self.model.joints.values() if joint.type == "prismatic")
        self.scene = SceneTree(self.model, info.path, publish)
        self.history, self.trail = History(names(info.joints, info.buses)), Trail()
        self.true_trail, self.world = Trail(), WorldView()
        self.drives, self.faults = VirtualDrives(info.nodes), DriveFaults()
        self.world_client = WorldClient(info.robot, self.drives)
        self.controllers: tuple[ControllerReading, ...] = ()
        self._node_jobs = {place.name: NodeJobs(info.robot, place) for place in info.places}
        self.live_reader = LiveReader()
        self._sampler = Sampler()
        self._scene: SceneChange = {}

    @property
    def node_names(self) -> list[str]:
        return list(self._node_jobs)

    def node_jobs(self, node: str) -> NodeJobs:
        """Return the jobs of a node, which all pages share."""
        return self._node_jobs[node]

    def resume(self, info: RobotInfo) -> bool:
        """Continue after a restart of the robot; return False if the robot's structure has changed."""
        if info.shape != self.info.shape:
            return False
        self.info, self.state, self.events = info, info.state, RecentEvents(info.events)
        return True

    def take(self, state: StateSample) -> SceneChange:
        """Update all data from a state sample; return the changes of the scene."""
        self.state = state
        self.history.add(state.time, self._sampler.take(state, commanded_interfaces(self.controllers, state)))
        if (pose := pose_of(state)) is not None:
            self.trail.add(pose)
        if (truth := true_pose_of(state)) is not None:
            self.true_trail.add(truth)
        before, now = self._scene, self.scene_now()
        self._scene = now
        return cast("SceneChange", {key: value for key, value in now.items() if value != before.get(key)})

    def scene_now(self) -> SceneChange:
        """Return the joint positions, the pose and the true pose of the base, and the joints with a drive in fault."""
        state = self.state
        bad = [row.joint for row in axis_rows(state) if row.tone == BAD and row.joint]
        pose, positions = pose_of(state), {name: joint.position for name, joint in state.joints.items()}
        angles, truth = angles_of(self.model, positions), true_pose_of(state)
        return {"angles": angles, "pose": _rounded(pose), "truth": _rounded(truth), "tint": bad}

    def content(self, lost: str) -> PageContent:
        """Return the content of the panels; `lost` is "" while the robot is connected, else the reason."""
        return PageContent(self.state, self.events, self.controllers, self.faults, lost)


def _rounded(pose: Pose | None) -> list[float] | None:
    return None if pose is None else [round(number, 4) for number in pose]


def _drawable(urdf: str) -> RobotModel:
    """Parse a URDF; if it is invalid, return an empty model with a note."""
    try:
        return read_model(urdf)
    except RobotConfigError as error:
        return RobotModel("robot", notes=(f"the description cannot be drawn: {error}",))
