"""The verb device: the verb drive for devices that are not drives, with inputs set by the verb fault."""

from __future__ import annotations

import json
from functools import partial

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.cli import device, drive
from canopen_control.cli.main import main
from canopen_control.virtual.control import NodeControl

CAN = "memory:cli-device"


@pytest.fixture
def node():
    with OnBus(CAN, {5: "generic_cia401.eds", 6: TMCM}) as devices:
        controls = [devices.call(partial(NodeControl, devices._host, item)) for item in devices.nodes.values()]
        yield devices.nodes[5]
        for control in controls:
            devices.call(control.close)


def test_it_is_the_verb_drive():
    assert device.run is drive.run
    assert "generic_cia401.eds" in device.EXAMPLE


def test_inputs_are_set_and_reported(node, capsys):
    assert main(["fault", "5", "di3=1,ai1=-20", "--can", CAN]) == 0
    assert capsys.readouterr().out == "node 5: di3 is 1, ai1 is -20\n"
    assert (node.get(0x6000, 1), node.get(0x6401, 2)) == (8, -20)
    assert main(["device", "--node-id", "5", "--can", CAN, "--status"]) == 0
    output = capsys.readouterr().out
    assert "  inputs: di0 0, di1 0, di2 0, di3 1," in output
    assert "  outputs: do0 0," in output


def test_they_are_reported_as_json_too(node, capsys):
    assert main(["fault", "5", "di0=1", "--can", CAN, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"node_id": 5, "signals": {"di0": 1.0}}
    assert main(["drive", "--node-id", "5", "--can", CAN, "--status", "--json"]) == 0
    assert {"name": "di0", "value": 1.0} in json.loads(capsys.readouterr().out)["signals"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["5", "di3="], "'di3=': write SIGNAL=NUMBER, as in di0=1,ai0=16384"),
        (["5", "=1"], "'=1': write SIGNAL=NUMBER"),
        (["5", "ai0=nan"], "'ai0=nan': write SIGNAL=NUMBER"),
        (["5", "di0=1", "on"], "a signal is set with SIGNAL=VALUE alone"),
        (["5", "di77=1"], "no signal 'di77' (did you mean"),
        (["5", "do0=1"], "do0 is an output, which only the master can set"),
        (["6", "di0=1"], "node 6 (TMCM-1270) has no signals, because it is a drive"),
    ],
)
@pytest.mark.usefixtures("node")
def test_what_cannot_be_set_is_refused_in_a_sentence(words, text, capsys):
    assert main(["fault", *words, "--can", CAN]) == 2
    assert text in capsys.readouterr().err
