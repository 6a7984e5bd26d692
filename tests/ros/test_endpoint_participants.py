from __future__ import annotations

import ctypes
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from canopen_control.ros import endpoint
from canopen_control.ros.endpoint import ActionClients, client_of, folder_of, runs

HOST, FAR = b"\x78\xfd", b"\x79\xfd"


def gid(process, host=HOST, vendor=b"\x01\x0f"):
    return [*vendor, *host, *process.to_bytes(2, "little"), *bytes(18)]


class Header:
    """An object that begins as pybind11's do: with a pointer, here to bytes, which have their length at 16."""

    __slots__ = ("at", "sequence_number")


def test_a_header_whose_number_is_not_where_it_should_be_names_no_client():
    header = Header()
    header.at, header.sequence_number = bytes(32), 32
    assert client_of(header)[8:] == ctypes.string_at(id(header.at) + 8, 4)  # before it are the references
    header.sequence_number = 33
    assert client_of(header) is None


def test_a_process_is_known_by_its_lower_16_bits_and_one_that_has_ended_does_not_run(tmp_path):
    for number, state in ((7, "Z"), (65536 + 9, "S"), (11, "R")):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "stat").write_text(f"{number} (a) b) {state} 1 2")
    assert [runs(value, tmp_path) for value in (7, 8, 9, 11)] == [False, False, True, True]
    assert runs(os.getpid() % 65536)


@pytest.fixture
def graph(monkeypatch):
    """An action's clients, of which the test says which are there, and which processes run."""
    graph = SimpleNamespace(clients=[], running={1, 2}, server=gid(os.getpid() % 65536))

    def look(topic, no_mangle):
        assert no_mangle
        gids = {"rq/arm/_action/send_goalRequest": graph.clients, "rt/arm/_action/status": [graph.server]}[topic]
        return [SimpleNamespace(endpoint_gid=item) for item in gids]

    monkeypatch.setattr(endpoint, "runs", lambda process: process in graph.running)
    graph.of = ActionClients(SimpleNamespace(get_publishers_info_by_topic=look), "/arm")
    return graph


def part(given):
    return bytes(given[:12])


def test_participants_known_to_dds_are_present(graph):
    graph.clients = [gid(1), gid(2), gid(2)]
    assert graph.of.present() == {part(gid(1)), part(gid(2))}
    graph.clients = []
    assert graph.of.present() == set()


@pytest.mark.parametrize("other", [gid(1, FAR), gid(1, HOST, b"\x01\x10")])
def test_of_a_client_elsewhere_no_process_is_looked_for(graph, other):
    assert not graph.of.runs_here(part(other))


def test_where_a_participant_is_made_in_another_way_no_process_is_looked_for(graph):
    graph.server = gid((os.getpid() + 1) % 65536)
    assert not graph.of.runs_here(part(gid(1)))
    graph.server = gid(os.getpid() % 65536, HOST, b"\x01\x10")
    assert not graph.of.runs_here(part(gid(1)))


def test_the_folder_of_a_client_of_this_host_is_seen_and_of_another_not():
    own = os.getpid() % 65536
    node = SimpleNamespace(get_publishers_info_by_topic=lambda _topic: [SimpleNamespace(endpoint_gid=gid(own))])
    assert folder_of(node, part(gid(own))) == Path.cwd()
    assert folder_of(node, part(gid(own, FAR))) is None
    assert folder_of(node, None) is None
