"""The verb restore: output and exit codes."""

import json
from pathlib import Path

import pytest
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cli.main import main


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:restore", {3: TMCM, 4: TMCM, 5: GENERIC}) as devices:
        devices.options = ["--can", "memory:restore"]
        yield devices


@pytest.fixture
def backup(bus, tmp_path, capsys):
    bus.call(lambda: bus.nodes[3].store.set(0x6081, 0, 1600))
    path = tmp_path / "left.dcf"
    assert main(["backup", "3", "-o", str(path), *bus.options, "--eds", TMCM]) == 0
    capsys.readouterr()
    bus.call(lambda: bus.nodes[3].store.set(0x6081, 0, 1))
    return str(path)


def values(bus, node_id):
    return dict(bus.nodes[node_id].store.values)


@pytest.mark.rest
def test_a_node_holds_its_backup_again(bus, backup, capsys):
    assert main(["restore", backup, "3", *bus.options]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "not written: 0x2705:00 Node-ID to store: is the node-ID or the bit rate",
        f"node 3: 131 parameters as in {backup}, 1 written; not stored: a power cycle undoes it (--store)",
    ]
    assert values(bus, 3)[0x6081, 0] == 1600
    assert main(["diff", backup, "3", *bus.options]) == 0


def test_what_is_stored_is_there_after_a_reset(bus, backup, capsys):
    assert main(["restore", backup, "3", *bus.options, "--store", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (reported["stored"], reported["written"], reported["verified"], reported["refused"]) == (True, 1, 131, [])
    assert bus.nodes[3].store.power_on[0x6081, 0] == 1600


def test_a_node_that_ran_runs_again(bus, backup):
    def start():
        bus.nodes[3].store.download(0x1017, 0, (20).to_bytes(2, "little"))
        bus.nodes[3].command(NmtCommand.START, bus.reactor.now())

    bus.call(start)
    assert main(["restore", backup, "3", *bus.options, "--protect", "0x1017"]) == 0
    assert bus.nodes[3].nmt.state is NmtState.OPERATIONAL


def test_what_is_protected_stays(bus, backup, capsys):
    assert main(["restore", backup, "3", *bus.options, "--protect", "profile vel*"]) == 0
    assert "not written: 0x6081:00 Profile velocity: --protect profile vel*" in capsys.readouterr().out
    assert values(bus, 3)[0x6081, 0] == 1
    assert main(["restore", backup, "3", *bus.options, "--protect", "0x7*"]) == 2
    assert "--protect 0x7* matches no parameter" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("node", "options", "code", "sentence"),
    [
        ("4", [], 2, "belongs to node 3, and node 4 is another drive; nothing was written"),
        ("5", ["--any-node"], 2, "belongs to a different product than node 5"),
        ("9", ["--any-node", "--timeout", "0.05"], 1, "node 9: 0x1000:00: no answer"),
    ],
)
def test_a_wrong_node_or_product_takes_nothing(bus, backup, capsys, node, options, code, sentence):
    before = bus.call(lambda: {node_id: values(bus, node_id) for node_id in (3, 4, 5)})
    assert main(["restore", backup, node, *bus.options, *options]) == code
    assert sentence in capsys.readouterr().err
    assert bus.call(lambda: {node_id: values(bus, node_id) for node_id in (3, 4, 5)}) == before


def test_an_enabled_drive_takes_nothing(bus, backup, capsys):
    bus.call(lambda: bus.nodes[3].store.on_read(0x6041, 0, lambda: 0x0637))
    assert main(["restore", backup, "3", *bus.options]) == 1
    assert capsys.readouterr().err == (
        "canopen-control: node 3 is enabled; nothing was written: disable it first, `axis disable`\n"
    )
    assert values(bus, 3)[0x6081, 0] == 1
    assert bus.nodes[3].nmt.state is NmtState.PRE_OPERATIONAL


@pytest.mark.rest
def test_a_refusal_leaves_the_drive_as_it_was_and_stores_nothing(bus, backup, capsys):
    def change():
        store = bus.nodes[3].store
        store.set(0x6083, 0, 9)
        store.ceilings.inject({0x6081: 1000})

    bus.call(change)
    before = values(bus, 3)
    assert main(["restore", backup, "3", *bus.options, "--store"]) == 1
    output = capsys.readouterr()
    assert "refused: 0x6081:00 Profile velocity: 1600 was written, but the drive reports 1000" in output.err
    assert output.out.endswith("node 3: 1 parameters refused; the drive is unchanged\n")
    assert values(bus, 3) == before
    assert (0x6081, 0) not in bus.nodes[3].store.power_on
    assert main(["restore", backup, "3", *bus.options, "--keep"]) == 1
    assert "the accepted values are kept, but not stored" in capsys.readouterr().out
    assert values(bus, 3)[0x6083, 0] == 0


@pytest.mark.rest
def test_what_a_file_gives_and_nothing_writes_is_named(bus, backup, capsys):
    text = Path(backup).read_text()
    at = text.index("[6502]") + len("[6502]")
    Path(backup).write_text(f"{text[:at]}\nParameterValue=7{text[at:]}")
    assert main(["restore", backup, "3", *bus.options]) == 0
    output = capsys.readouterr().out
    assert "never written (read-only, commands, live values): 0x6502:00 Supported drive modes" in output


@pytest.mark.parametrize("content", ["", "[FileInfo]\n", "not a file of that kind"])
def test_a_wrong_file_is_reported(bus, tmp_path, capsys, content):
    path = tmp_path / "wrong.dcf"
    path.write_text(content)
    assert main(["restore", str(path), "3", *bus.options]) == 2
    assert str(path) in capsys.readouterr().err
    assert main(["restore", "gone", "3", *bus.options]) == 2
    assert "create one with: canopen-control backup NODE -o gone" in capsys.readouterr().err
