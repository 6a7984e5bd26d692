import struct

import pytest
from support.robots import Bench
from support.tracing import robby_decoder, robby_network

from canopen_control.frame import CanFrame
from canopen_control.rpc.messages.layout import MappedEntry, PdoLayout
from canopen_control.trace.dbc import WORD_PARTS, dbc_text
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription, NodeDescription

cantools = pytest.importorskip("cantools", reason="cantools, the independent reader of DBC files, is not installed")


def database(network):
    return cantools.database.load_string(dbc_text(network), "dbc")


def values_of(db, can_id, data):
    """Return what cantools reads, words put together again from their parts."""
    message = db.get_message_by_frame_id(can_id)
    read = message.decode(data, decode_choices=False)
    whole = dict(read)
    for word in ("Statusword", "Controlword"):
        parts = [part for table in WORD_PARTS.values() for part in table if f"{word}_{part.name}" in read]
        parts = [part for part in parts if message.get_signal_by_name(f"{word}_{part.name}").start == part.start]
        if parts:
            whole[word] = sum(int(whole.pop(f"{word}_{part.name}")) << part.start for part in parts)
    return whole


def test_frames_of_a_running_robot_are_read_by_cantools_as_by_the_decoder():
    bench, db, decoder = Bench("dbc"), database(robby_network()), robby_decoder()
    bench.start()
    bench.hold(1.0, -2.0, ms=500)
    observed = {}
    for _, frame in bench.bus.history:
        decoded = decoder.decode(frame)
        if decoded.service == "pdo":
            observed.setdefault(decoded.subject, set()).add(frame.data)
            ours = {value.name.replace(" ", "_"): value.value for value in decoded.values}
            assert values_of(db, frame.can_id, frame.data) == ours
    bench.close()
    assert set(observed) == {"RPDO1", "RPDO2", "TPDO1", "TPDO2"}
    assert min(len(different) for different in observed.values()) > 2  # it has moved, in several states


def test_words_and_modes_are_named():
    db = database(robby_network())
    status = db.decode_message(0x183, bytes.fromhex("371603"))
    assert str(status["Statusword_state"]) == "OPERATION ENABLED"
    assert str(status["Modes_of_operation_display"]) == "PV"
    assert status["Statusword_target_reached"] == 1
    control = db.decode_message(0x203, bytes.fromhex("800003"))
    assert str(control["Controlword_command"]) == "FAULT RESET"
    assert str(db.decode_message(0x703, b"\x05")["NMT_state"]) == "OPERATIONAL"
    assert str(db.decode_message(0x083, bytes.fromhex("1186210000000000"))["error_code"]) == "following error"
    assert db.get_message_by_frame_id(0x080).name == "SYNC"
    assert str(db.decode_message(0x000, b"\x01\x03")["NMT_node_id"]) == "left_drive"


def test_every_type_and_every_place_is_read_back():
    objects = (
        MappedEntry(0x2000, 0, 4, "INTEGER8", "nibble"),
        MappedEntry(0x0005, 0, 8, "UNSIGNED8", "dummy"),
        MappedEntry(0x2001, 1, 12, "UNSIGNED16", "1st (odd) name, of more than thirty-two characters"),
        MappedEntry(0x2001, 2, 8, "INTEGER8", "1st (odd) name, of more than thirty-two characters"),
        MappedEntry(0x2002, 0, 32, "REAL32", "Überdruck"),
    )
    node = NodeDescription("node one", 9, None, (PdoLayout(0x80012345, "tpdo", 1, objects=objects),))
    network = NetworkDescription(nodes={9: node})
    image = 0xF | 0xAB << 4 | 0x123 << 12 | 0x80 << 24
    data = image.to_bytes(4, "little") + struct.pack("<f", 0.5)
    db = database(network)
    message = db.get_message_by_frame_id(0x12345)
    assert message.is_extended_frame
    ours = [value.value for value in Decoder(network).decode(CanFrame(0x80012345, data)).values]
    assert list(message.decode(data).values()) == ours == [-1, 0x123, -128, 0.5]
    assert all(len(signal.name) <= 32 for signal in message.signals)
    assert len({signal.name for signal in message.signals}) == 4


def test_nodes_with_one_name_stay_apart():
    nodes = {number: NodeDescription("drive", number) for number in (4, 5)}
    db = database(NetworkDescription(nodes=nodes))
    assert {node.name for node in db.nodes} == {"master", "drive", "drive_2"}


def test_numbers_are_scaled_with_their_unit_where_it_is_known():
    pdo = PdoLayout(
        0x181,
        "tpdo",
        1,
        objects=(
            MappedEntry(0x6064, 0, 32, "INTEGER32", "Position", 0.00025, -0.5, "m"),
            MappedEntry(0x606C, 0, 32, "INTEGER32", "Velocity"),
        ),
    )
    db = database(NetworkDescription(nodes={1: NodeDescription("lift", 1, pdos=(pdo,))}))
    message = db.get_message_by_frame_id(0x181)
    position, velocity = (message.get_signal_by_name(name) for name in ("Position", "Velocity"))
    assert (position.scale, position.offset, position.unit) == (0.00025, -0.5, "m")
    assert (velocity.scale, velocity.offset, velocity.unit) == (1, 0, None)
    assert message.decode(struct.pack("<ii", -4000, 7)) == {"Position": -1.5, "Velocity": 7}
