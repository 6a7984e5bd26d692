import asyncio
import dataclasses
import math
import threading

import pytest
from support.host import eventually
from support.pages import StubDesk, info, robot, state
from support.service_node import NodeStub

from canopen_control.commissioning.jobs import FIRMWARE, RESTORE, JobRun
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds
from canopen_control.view.robot_view import RobotView


def test_a_robot_that_returns_continues_and_another_one_does_not():
    view = robot()
    view.take(state())
    assert view.resume(info(state="starting"))
    assert view.state.state == "starting"
    assert view.history.rows()
    assert not view.resume(info(joints={"other": {}}))


def test_only_what_has_moved_is_sent():
    view = robot()
    assert set(view.take(state())) == {"angles", "tint"}
    assert view.take(state()) == {}
    moved = view.take(state(samples={"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0}}))
    assert moved == {"pose": [1.0, 0.0, 0.0]}
    assert list(view.trail.points) == [(1.0, 0.0)]


def test_the_true_pose_of_a_simulated_base_has_its_own_trail_in_the_odometry_frame():
    view = robot()
    odometry = {"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0}}
    view.take(state(samples=odometry))
    turned = {"time": 1.0, "x": 5.0, "y": 1.1, "heading": math.pi / 2, "odom": [5.0, 0.0, math.pi / 2]}
    assert view.take(state(samples=odometry, true_pose=turned)) == {"truth": [1.1, 0.0, 0.0]}
    assert (list(view.trail.points), list(view.true_trail.points)) == ([(1.0, 0.0)], [(1.1, 0.0)])
    unaligned = {"time": 1.0, "x": 5.0, "y": 1.1, "heading": 0.0}
    assert view.take(state(samples=odometry, true_pose=unaligned)) == {"truth": None}


@pytest.mark.parametrize("urdf", ["", "<robot", "<robot><link/><joint/></robot>"])
def test_a_description_that_cannot_be_read_is_a_note_and_no_error(urdf):
    view = RobotView(dataclasses.replace(info(), urdf=urdf), lambda _content, kind: f"/mesh/1.{kind}")
    assert view.scene.tree["joints"] == []
    (note,) = view.scene.notes
    assert note.startswith("the description cannot be drawn: <urdf>")


# -- node jobs


OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


def desk(objects=None):
    return StubDesk(NodeStub(objects or {}), OD)


def test_a_question_is_answered_from_a_thread():
    result = asyncio.run(
        desk({(0x6041, 0): b"\x37\2"}).ask(lambda session: (session.read(0x6041), threading.get_ident()))
    )
    assert result[0] == b"\x37\2"
    assert result[1] != threading.get_ident()


def test_long_work_reports_how_far_it_is_and_what_came_of_it():
    node, go = desk(), threading.Event()
    work = JobRun(RESTORE, "reading left_drive", "objects")

    def read(_session, reported):
        reported.at(3, 10)
        assert go.wait(60)
        return "10 parameters"

    assert node.begin(work, read) is None
    assert eventually(lambda: (work.done, work.total) == (3, 10))
    assert (node.busy, work.over) == (True, False)
    second = node.begin(JobRun(FIRMWARE, "loading left_drive"), read)
    assert second == "left_drive is busy: reading left_drive; wait until this has ended"
    go.set()
    assert eventually(lambda: work.over)
    assert (work.sentence, work.good, node.busy) == ("10 parameters", True, False)


def test_long_work_that_fails_reports_why():
    def refuse(_session, _work):
        raise DriveError("left_drive is enabled; nothing was written")

    def break_down(_session, _work):
        raise ZeroDivisionError("a mistake")

    for function, words in ((refuse, "is enabled; nothing"), (break_down, "restoring ended with ZeroDivisionError")):
        node, work = desk(), JobRun(RESTORE, "restoring")
        assert node.begin(work, function) is None
        assert eventually(lambda work=work: work.over)
        assert words in work.sentence
        assert work.good is False


def test_work_that_is_asked_to_end_ends_at_its_next_step():
    work = JobRun(RESTORE, "restoring")
    work.at(1, 2)
    work.end()
    with pytest.raises(DriveError, match="a page requested the end"):
        work.at(2, 2)
    assert work.done == 2


def test_an_object_is_written_and_undone_for_all_pages():
    node = desk({(0x6081, 0): bytes(4)})
    edit = asyncio.run(node.write(OD[0x6081, 0], "1234"))
    assert (edit.before, edit.after) == (0, 1234)
    assert asyncio.run(node.undo()).after == 0
    with pytest.raises(ConfigError, match="read-only"):
        asyncio.run(node.write(OD[0x6041, 0], "1"))


def test_nothing_is_written_alongside_long_work():
    node, go = desk({(0x6081, 0): bytes(4)}), threading.Event()
    node.begin(JobRun(RESTORE, "restoring a.dcf"), lambda _session, _work: str(go.wait(60)))
    with pytest.raises(DriveError, match=r"left_drive is busy: restoring a\.dcf; nothing was written"):
        asyncio.run(node.write(OD[0x6081, 0], "1234"))
    go.set()
    assert node.stub.written == []
