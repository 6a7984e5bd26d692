"""Messages of a robot made of plain documents: the names of nodes and joints are their keys."""

from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample, Status
from canopen_control.rpc.wire import convert, plain
from canopen_control.runtime import status
from canopen_control.runtime.node_readings import event_message


def _named(document):
    named = {
        kind: {name: {"name": name, **fields} for name, fields in document[kind].items()}
        for kind in ("nodes", "joints")
        if kind in document
    }
    return {**document, **named}


def sample_of(document):
    return convert(_named(document), StateSample)


def status_of(document):
    return convert(_named(document), Status)


def event_of(document):
    return convert({"node": None, "kind": "test", "level": "info", "text": "", **document}, RobotEvent)


def controllers_of(documents):
    return tuple(convert({"type": "", "state": "", **document}, ControllerReading) for document in documents)


def status_dict(robot):
    return plain(status.status_message(robot))


def state_dict(robot):
    return plain(status.state_sample(robot))


def event_dict(robot, event):
    return plain(event_message(event, robot.wall_offset_ns))


def nodes_dict(robot):
    return plain(status.nodes_message(robot))


def layout_dict(robot):
    return plain(status.layout_message(robot))
