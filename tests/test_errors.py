from __future__ import annotations

import inspect

import pytest

from canopen_control import errors

TREE = {
    name: member
    for name, member in vars(errors).items()
    if inspect.isclass(member) and issubclass(member, errors.CanopenError)
}

MESSAGES = [
    (errors.EdsError("a.eds", 12, "no such section"), "a.eds:12: no such section"),
    (errors.EdsError("a.eds", 0, "empty"), "a.eds: empty"),
    (errors.BusConfigError("bus.yml", 3, "nodes", "bus.yml:3: nodes: wrong"), "bus.yml:3: nodes: wrong"),
    (errors.BusClosed("local:robby"), "bus local:robby: closed"),
    (errors.BusOff("can0"), "check the cable"),
    (errors.InterfaceNotFound("can7", "try can0"), "no CAN interface 'can7'; try can0"),
    (errors.InterfaceNotFound("can7"), "no CAN interface 'can7'"),
    (errors.BusNotOpen("local:x"), "bus local:x: no program has it open; no local bus is open now"),
    (
        errors.BusNotOpen("local:x", ["local:a", "local:b"]),
        "open now: local:a, local:b; start one with canopen-control run",
    ),
    (errors.InterfaceDown("can0"), "ip link set can0 up"),
    (
        errors.SdoAbort(3, 0x607A, 0, 0x06020000, "object does not exist", "left"),
        "node 3 (left): 0x607A:00: abort 0x06020000 (object does not exist)",
    ),
    (errors.SdoAbort(3, 0x607A, 0, 0x12345678), "unknown code"),
    (errors.SdoTimeout(3, 0x1000, 0, 1.5), "node 3: 0x1000:00: no answer within 1.5 s"),
    (
        errors.SdoStopped(errors.SdoTimeout(3, 0x1000, 0, 1.5, "left")),
        "node 3 (left): 0x1000:00: no answer within 1.5 s; its",
    ),
    (errors.SdoStopped(errors.SdoTimeout(3, 0x1000, 0, 1.5)), "`nmt preop`"),
    (errors.SdoRestarted(3, 0x1F50, 1, "left"), "node 3 (left): 0x1F50:01: the node restarted during the transfer"),
    (errors.SdoCancelled(3, 0x2000, 0, "left"), "node 3 (left): 0x2000:00: the transfer was cancelled"),
    (
        errors.SdoLengthError(3, 0x6041, 0, b"\x50", "UNSIGNED16 has 2", "Statusword", "left"),
        "node 3 (left): 0x6041:00 Statusword: answered 1 byte (50), UNSIGNED16 has 2; is this the EDS",
    ),
    (errors.SdoLengthError(3, 0x6041, 0, b"", "UNSIGNED16 has 2"), "node 3: 0x6041:00: answered 0 bytes, UNSIGNED16"),
    (errors.BootError(3, "B", "read 0x1000"), "node 3: boot error B: read 0x1000"),
    (errors.HeartbeatLost(3, 0.25, "left"), "node 3 (left): no heartbeat for 0.250 s"),
    (errors.UnsupportedMode("CSV", ("PP", "PV")), "0x6502 lists PP, PV"),
    (errors.UnsupportedMode("CSV", ()), "lists none"),
    (errors.InterfaceConflict("a/velocity", "diff"), "claimed by diff; deactivate"),
    (errors.TrajectoryRefused("arm refuses the trajectory: it has no points", -1), "it has no points"),
    (errors.UnknownInterface("a/velo", ("a/velocity",)), "available: a/velocity"),
    (errors.UnknownInterface("a/velo"), "no interface 'a/velo'"),
    (
        errors.DiskFull("/x/a.log", "No space left on device", "2 frames are in it"),
        "/x/a.log: No space left on device; 2",
    ),
    (errors.RemoteError("InterfaceConflict", "taken"), "taken"),
    (errors.UnreadableMessage("robby sent garbage: Expected `str`, got `int`"), "robby sent garbage"),
]


@pytest.mark.parametrize(("error", "words"), MESSAGES, ids=lambda value: type(value).__name__)
def test_the_message_reports_what_and_where(error, words):
    assert words in str(error)
    assert isinstance(error, errors.CanopenError)


def test_every_error_with_fields_has_its_message_tested():
    with_fields = {name for name, member in TREE.items() if "__init__" in vars(member)}
    assert with_fields - {type(error).__name__ for error, _ in MESSAGES} == {"RemoteProtocolError"}


def test_the_docstring_draws_the_tree_as_it_is():
    drawn: dict[str, str | None] = {}
    path: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        depth, name = (len(line) - len(line.lstrip())) // 2, line.strip().partition(" ")[0]
        if name in TREE:
            path[depth:] = [name]
            drawn[name] = path[depth - 1] if depth else None
    actual = {name: member.__bases__[0].__name__ for name, member in TREE.items()}
    assert {name: parent for name, parent in drawn.items() if parent} == {
        name: parent for name, parent in actual.items() if parent in TREE and name in drawn
    }
    assert set(TREE) == set(drawn)


def test_the_field_values_stay_readable():
    abort = errors.SdoAbort(3, 0x607A, 1, 0x06090030)
    assert (abort.node_id, abort.index, abort.subindex, abort.code) == (3, 0x607A, 1, 0x06090030)
    assert errors.HeartbeatLost(3, 0.5).age == 0.5
    assert errors.RemoteProtocolError(4, "odd").node_id == 4


def test_the_nearest_name_is_offered_and_otherwise_what_there_is():
    assert errors.nearest("velocty", ["velocity", "position"]) == " (did you mean 'velocity'?)"
    assert errors.nearest("zzz", ["velocity", "position"]) == "; known: velocity, position"
    assert errors.nearest("zzz", []) == ""


def test_the_nearest_name_has_any_case_and_is_not_the_opposite():
    assert errors.nearest("SubIndex", ["index", "sub_index", "value"]) == " (did you mean 'sub_index'?)"
    assert errors.nearest("disabled", ["enabled"]) == "; known: enabled"


def test_the_nearest_name_has_the_same_words_in_any_order_and_no_opposite_one():
    wheels = ["left_wheel_joint", "right_wheel_joint"]
    assert errors.nearest("wheel_right_joint", wheels) == " (did you mean 'right_wheel_joint'?)"
    assert errors.nearest("wheel_left_joint", wheels) == " (did you mean 'left_wheel_joint'?)"
    assert errors.nearest("rigth_wheel_joint", wheels) == " (did you mean 'right_wheel_joint'?)"
    assert errors.nearest("left_wheel_joint", ["right_wheel_joint"]) == "; known: right_wheel_joint"
    assert (
        errors.nearest("front_left_wheel", ["rear_left_wheel", "front_left_whel"])
        == " (did you mean 'front_left_whel'?)"
    )


def test_what_was_typed_wrong_is_of_usage_here_and_over_there():
    usage = (
        errors.ConfigError,
        errors.InterfaceDown,
        errors.InterfaceNotFound,
        errors.UnknownName,
        errors.WrongValueCount,
    )
    for name, member in TREE.items():
        over_there = errors.RemoteError(name, "refused")
        assert over_there.of_usage is issubclass(member, usage), name
    assert errors.ConfigError("no such folder").of_usage
    assert not errors.ControlError("it is active").of_usage
    assert not errors.RemoteError("Sequence", "no class of errors").of_usage
    assert not errors.RemoteError("nearest", "no class at all").of_usage


@pytest.mark.parametrize(
    ("text", "rest"),
    [
        ("node 2 (left): no heartbeat for 0.5 s", "no heartbeat for 0.5 s"),
        ("node 2: 0x1000:00: no answer", "0x1000:00: no answer"),
        ("node 2 (left) has restarted by itself", "it has restarted by itself"),
        ("node 20: no answer", "node 20: no answer"),
        ("node 2 (right): no answer", "node 2 (right): no answer"),
        ("EMCY 0x4310", "EMCY 0x4310"),
        ("", ""),
    ],
)
def test_an_error_is_reported_without_the_node_where_the_sentence_names_it(text, rest):
    assert errors.without_node(text, 2, "left") == rest
