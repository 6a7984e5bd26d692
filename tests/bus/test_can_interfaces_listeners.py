"""Listeners of an interface, read from a /proc as written by Linux 6.1."""

from __future__ import annotations

import os

import pytest

from canopen_control.bus import can_interfaces
from canopen_control.bus.can_interfaces import Listener, count_hearing, find_listeners

HEAD = """
receive list 'rx_{}':
  (any: no entry)
  device   can_id   can_mask      function          userdata       matches  ident
"""
ROW = "   {}     {:03x}    {:08x}  000000006b966528  {:016x}         0  {}\n"
BCM = """>>> socket 00000000cb28b815 / sk 0000000059b600d4 / bo 0000000059b600d4 / dropped 0 / bound vcan0 <<<
tx_op: 080 vcan0 [1] t2=20000 # sent 26
tx_op: 12345678 vcan0 [2] t1=10 t2=500000 # sent 3
rx_op: 123 vcan0 [1] timeo=5 # recv 0 (0) => reduction: 0%

"""


class Proc:
    """A /proc with processes; `sockets` maps (pid, descriptor) to (interface, identifiers) or an OSError."""

    def __init__(self, folder, monkeypatch):
        self.folder, self.protocols, self.sockets = folder, {}, {}
        for name in ("net/can", "net/can-bcm", "self", "17/fd"):
            (folder / name).mkdir(parents=True)
        monkeypatch.setattr(can_interfaces.os, "getxattr", self._getxattr)
        monkeypatch.setattr(can_interfaces, "_borrowed", self._borrowed)

    def add(self, pid, words, **descriptors):
        (self.folder / str(pid) / "fd").mkdir(parents=True, exist_ok=True)
        (self.folder / str(pid) / "cmdline").write_bytes(b"".join(word.encode() + b"\0" for word in words))
        for number, (inode, protocol, answer) in descriptors.items():
            os.symlink(f"socket:[{inode}]", self.folder / str(pid) / "fd" / number[1:])
            self.protocols[pid, int(number[1:])] = protocol
            self.sockets[pid, int(number[1:])] = answer

    def _getxattr(self, path, name):
        assert name == "system.sockprotoname"
        protocol = self.protocols[int(path.parent.parent.name), int(path.name)]
        if protocol is None:
            raise OSError(95, "Operation not supported")
        return protocol.encode() + b"\0"

    def _borrowed(self, pid, descriptor, protocol):
        answer = self.sockets[pid, descriptor]
        if isinstance(answer, OSError):
            raise answer
        return answer


@pytest.fixture
def proc(tmp_path, monkeypatch):
    return Proc(tmp_path, monkeypatch)


def test_processes_are_named_with_what_they_receive_and_others_are_left_out(proc):
    python = "/usr/bin/python3"
    proc.add(30, ["candump", "-L", "vcan0"], d0=(1, None, None), d3=(69, "CAN_RAW", ("vcan0", -1)))
    proc.add(9, [python, "-P", "-m", "canopen_control", "run", "robby"], d5=(70, "CAN_RAW", ("vcan0", 13)))
    proc.add(10, [f"{python} -P -m canopen_control drive --eds /a/b.eds"], d5=(78, "CAN_RAW", ("vcan0", 4)))
    proc.add(40, ["/usr/bin/cangen", "vcan0"], d3=(71, "CAN_RAW", ("vcan0", 0)))
    proc.add(41, ["/usr/bin/candump", "any"], d3=(72, "CAN_RAW", ("", -1)))
    proc.add(42, ["candump", "can0"], d3=(73, "CAN_RAW", ("can0", -1)))
    proc.add(43, [python, "mine.py"], d3=(74, "CAN_RAW", PermissionError(1, "no")), d4=(75, "TCP", None))
    proc.add(45, [python, "-S", "-c", "import canopen_control"], d3=(77, "CAN_RAW", ("vcan0", -1)))
    proc.add(44, ["candump", "vcan0"], d3=(76, "CAN_RAW", ("vcan0", None)), d4=(76, "CAN_RAW", ("vcan0", None)))
    assert find_listeners("vcan0", proc.folder) == [
        Listener(9, "canopen-control run robby", "CAN_RAW", "vcan0", 13),
        Listener(10, "canopen-control drive --eds /a/b.eds", "CAN_RAW", "vcan0", 4),
        Listener(30, "candump -L vcan0", "CAN_RAW", "vcan0", -1),
        Listener(40, "cangen vcan0", "CAN_RAW", "vcan0", 0),
        Listener(41, "candump any", "CAN_RAW", "", -1),
        Listener(43, "mine.py", "CAN_RAW", None),
        Listener(44, "candump vcan0", "CAN_RAW", "vcan0", None),
        Listener(45, "python3 -S -c import canopen_control", "CAN_RAW", "vcan0", -1),
    ]


def test_tasks_of_the_broadcast_manager_are_found_by_the_sockets_inode(proc):
    (proc.folder / "net/can-bcm/68").write_text(BCM)
    (proc.folder / "net/can-bcm/69").write_text(BCM.replace("vcan0", "can1"))
    (proc.folder / "net/can-bcm/70").write_text("as another kernel may write it")
    proc.add(30, ["master"], d3=(68, "CAN_BCM", None), d4=(69, "CAN_BCM", None), d5=(70, "CAN_BCM", None))
    assert find_listeners("vcan0", proc.folder) == [
        Listener(30, "master", "CAN_BCM", "vcan0", 0, ((0x80, 20_000), (0x12345678, 500_000))),
        Listener(30, "master", "CAN_BCM", None),
    ]


def test_a_process_that_ends_meanwhile_or_is_another_users_is_passed_over(proc, monkeypatch):
    proc.add(30, ["candump"], d3=(69, "CAN_RAW", ProcessLookupError(3, "gone")))
    (proc.folder / "30/cmdline").unlink()
    (proc.folder / "31").mkdir()
    assert find_listeners("vcan0", proc.folder) == []


def test_sockets_that_receive_are_counted_once_each_by_the_kernels_receive_lists(proc):
    lists = {
        "all": ROW.format("vcan0", 0, 0, 0xAA, "raw") + ROW.format("any", 0, 0, 0xBB, "raw"),
        "fil": ROW.format("vcan0", 0x200, 0x700, 0xCC, "raw") + ROW.format("vcan0", 0x123, 0x7FF, 0xCC, "raw"),
        "sff": ROW.format("vcan1", 0x123, 0xC00007FF, 0xDD, "raw") + ROW.format("vcan0", 1, 2, 0xEE, "bcm"),
        "err": ROW.format("vcan0", 0, 0x1FFFFFFF, 0xFF, "raw"),
    }
    for name, rows in lists.items():
        (proc.folder / f"net/can/rcvlist_{name}").write_text(HEAD.format(name) + rows)
    assert count_hearing("vcan0", proc.folder) == 4, "aa, bb, cc, ee"
    assert count_hearing("vcan1", proc.folder) == 2, "bb, dd"
