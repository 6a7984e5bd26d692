"""Objects of the nodes through the API, byte by byte, in simulated time."""

from base64 import b64decode
from types import SimpleNamespace

import pytest
from support.apiclient import base64_of

from canopen_control.runtime import api_objects


def test_objects_are_read_and_written_through_the_robots_own_client(client):
    assert client.ask("sdo_read", node="left_drive", index=0x6083)["result"] == {"data": base64_of("803e0000")}
    assert client.ask("sdo_write", node="3", index=0x6083, data=base64_of("a00f0000"))["result"] == {}
    assert client.ask("sdo_read", node=3, index=0x6083, subindex=0)["result"] == {"data": base64_of("a00f0000")}
    read = client.ask("sdo_read", node="left_drive", index=0x1008, block=True, timeout=2.0)["result"]
    assert b64decode(read["data"]).startswith(b"TMCM-1270")
    assert "timeout" in client.ask("sdo_read", node="left_drive", index=0x1008, timeout=-1)["error"]["message"]
    error = client.ask("sdo_read", node="left_drive", index=0x5FF0)["error"]
    assert error["kind"] == "SdoAbort"
    assert "0x06020000" in error["message"]


@pytest.mark.sources
def test_a_long_object_is_written_in_pieces(client, robby):
    written = []
    robby.robot.node("left_drive").sdo.write = lambda *args, **_: written.append(args) or SimpleNamespace()
    for piece in (base64_of("01" * 24_000), base64_of("02" * 24_000)):
        assert client.ask("sdo_data", data=piece)["result"] == {}
    client.send(id=2, method="sdo_write", params={"node": "left_drive", "index": 0x2000, "data": base64_of("03")})
    robby.run(100)
    assert written == [(0x2000, 0, b"\1" * 24_000 + b"\2" * 24_000 + b"\3")]
    client.send(id=3, method="sdo_write", params={"node": "left_drive", "index": 0x2000, "data": base64_of("04")})
    robby.run(100)
    assert written[1] == (0x2000, 0, b"\4")


def test_more_pieces_than_an_object_may_have_are_refused_and_forgotten(client, robby, monkeypatch):
    monkeypatch.setattr(api_objects, "MAX_OBJECT", 1000)
    assert client.ask("sdo_data", data=base64_of("00" * 600))["result"] == {}
    assert "more than 1000 bytes" in client.ask("sdo_data", data=base64_of("00" * 600))["error"]["message"]
    assert client.ask("sdo_data", data=base64_of("00" * 600))["result"] == {}


def test_the_events_say_what_was_written_and_by_whom(client, robby):
    for source in ({"source": "view"}, {}):
        answer = client.ask("sdo_write", node="left_drive", index=0x6083, data=base64_of("a00f0000"), **source)
        assert answer["result"] == {}
    told = [event for event in robby.robot.events.recent if event.kind == "object_written"]
    assert [event.node for event in told] == ["left_drive", "left_drive"]
    assert told[0].text == "view wrote 4000 to 0x6083:00 Profile acceleration"
    assert told[1].text.startswith("client ")
    assert "(pid " in told[1].text


def test_what_a_node_refuses_was_not_written(client, robby):
    answer = client.ask("sdo_write", node="left_drive", index=0x1018, subindex=1, data=base64_of("00000000"))
    assert answer["error"]["kind"] == "SdoAbort"
    assert not [event for event in robby.robot.events.recent if event.kind == "object_written"]


def test_a_client_may_ask_how_far_a_transfer_is(client, robby):
    assert client.ask("sdo_progress", node="left_drive")["result"] == {"done": 0, "total": None}
    assert client.ask("sdo_progress", node="nobody")["error"]["kind"] == "UnknownName"


def test_the_events_say_who_has_taken_a_node_out(client, robby):
    for source in ({"source": "view"}, {}):
        assert client.ask("nmt", node="left_drive", command="preop", **source)["result"] == {}
    told = [event for event in robby.robot.events.recent if event.kind == "nmt_asked"]
    assert [event.node for event in told] == ["left_drive", "left_drive"]
    assert told[0].text == "view asked for NMT preop"
    assert told[1].text.startswith("client ")
