"""The run of a judged device, at a master that keeps everything."""

import threading

import canopen
import pytest
from support.broken_masters import worked
from support.scripted_master import ScriptedMaster

from canopen_control.bus.channel import open_port
from canopen_control.conformance import master_run
from canopen_control.conformance.master_drive import Stage
from canopen_control.conformance.master_run import MasterRun
from canopen_control.data_files import data_path
from canopen_control.host.reactor import Reactor
from canopen_control.virtual.device import make_device

REACTIONS = (("fault", 0), ("power", 0), ("leaves", 0), ("flood", 0), ("heartbeat", 0), ("silent", 0))
RESETS = tuple(("reset", number) for number in range(5))


@pytest.mark.parametrize("fault", [*REACTIONS, *RESETS])
def test_a_master_that_keeps_everything_passes_each_fault(fault):
    failed, passed = worked(ScriptedMaster, [fault]).verdicts()
    assert failed == {}
    assert len(passed) > 30


def test_a_late_answer_and_a_refused_write_are_tested():
    assert "MT10" in worked(ScriptedMaster, [("reset", 3)]).verdicts()[1]
    assert "MC14" in worked(ScriptedMaster, [("reset", 4)]).verdicts()[1]
    assert "MT05" in worked(ScriptedMaster, [("reset", 1)]).verdicts()[1]


# The master of another library, the `canopen` package's BaseNode402 as its users write it: its known failures.


NODE, S = 5, 1_000_000_000
EDS = str(data_path("eds", "generic_cia402.eds"))
KNOWN = {
    "MC02": "0x1017:00 was written before 0x1000 was read",  # it identifies no device
    "MC03": "0x1017:00 was written before 0x1018 was read",
    "MC06": "neither 0x1016 nor 0x100C and 0x100D",  # a drive does not notice its end
    "MF01": "controlword 0x000F",  # its periodic RPDO continues after EMCY and FAULT
    "MF02": "0x60FF from 1000 to 1000",
}


class Program:
    """A program with the package: it configures a drive, enables it, and commands a velocity until `ended`."""

    def __init__(self):
        self.network = canopen.Network()
        self.network.connect(interface="virtual", channel="judged")
        self.node = canopen.BaseNode402(NODE, EDS)
        self.network.add_node(self.node)
        self.ended = threading.Event()
        self.states = []
        self.thread = threading.Thread(target=self.work)

    def work(self):
        node = self.node
        node.nmt.send_command(0x82)
        node.nmt.wait_for_bootup(5)
        node.sdo[0x1017].raw = 100
        node.setup_402_state_machine()
        for pdo, objects in ((node.rpdo[1], (0x6040, 0x60FF)), (node.tpdo[1], (0x6041, 0x6061))):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.enabled, pdo.trans_type = True, 1
            pdo.save()
        self.network.sync.start(0.02)
        node.nmt.state = "OPERATIONAL"
        node.rpdo[1].start(0.02)
        node.setup_402_state_machine(read_pdos=False)
        node.op_mode = "PROFILED VELOCITY"
        node.state = "OPERATION ENABLED"
        self.states.append(node.state)
        node.rpdo[1][1].raw = 1000
        self.ended.wait(60)

    def close(self):
        self.ended.set()
        self.thread.join(60)
        self.network.sync.stop()
        self.node.rpdo[1].stop()
        self.network.disconnect()


@pytest.mark.rest
def test_the_known_failures_of_the_master_of_another_library_are_found(monkeypatch):
    monkeypatch.setattr(master_run, "FIRST_NS", 3 * S)
    program, port = Program(), open_port("virtual:judged")
    with Reactor() as reactor:
        run = MasterRun(reactor, port, make_device(EDS, NODE), 12.0, lambda _line: None)
        run._stages = [Stage("fault", "EMCY and FAULT", "drive_fault", 2 * S, S // 2)]
        program.thread.start()
        report = run.run()
        program.close()
        port.close()
    assert program.states == ["OPERATION ENABLED"]
    failed = {result.id: result.observed for result in report.results if result.verdict == "failed"}
    of_machine = {"MY06", "MP03"}  # jitter, and an RPDO whose thread is not that of SYNC
    assert failed.keys() - of_machine == KNOWN.keys()
    assert [check_id for check_id, came in KNOWN.items() if not failed[check_id].startswith(came)] == []
    assert report.failed
