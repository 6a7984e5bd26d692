"""SDO with the `canopen` package, which is written by others, over a bus between processes; both ways.

Lengths and abort codes are moved in one process (`tests/cia301/test_sdo_interop.py`). Known deviations of canopen 2.4,
each met by a test here:
- its server answers a block upload as a plain one, and refuses a block download with 0x05040001;
- its client refuses a server's switch from block upload to a plain one; it never offers the switch either.
"""

import can
import canopen
import pytest
from support.channel import channel_of, python_can_of
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.data_files import data_path
from canopen_control.errors import SdoTimeout
from canopen_control.interop.canopen import to_canopen
from canopen_control.master.direct import DirectBus
from canopen_control.od.codec import decode, encode
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType

NAME = "interop"
CHANNEL = channel_of(NAME)
DRIVE, SERVO, THEIRS = 3, 5, 7


def dictionary(eds, node_id):
    return to_canopen(read_eds(data_path("eds", eds), node_id).od)


def content(length):
    return bytes(n % 251 for n in range(length))


@pytest.fixture
def network(private_folders):
    network = canopen.Network(can.Bus(**python_can_of(NAME)))
    network.NOTIFIER_CYCLE = 0.05  # seconds that its thread takes to end
    network.connect()
    yield network
    network.disconnect()


@pytest.fixture
def theirs(network):
    """Return their client on our drives: node-ID to RemoteNode."""
    nodes = {
        DRIVE: canopen.RemoteNode(DRIVE, dictionary(TMCM, DRIVE)),
        SERVO: canopen.RemoteNode(SERVO, dictionary(GENERIC, SERVO)),
    }
    with OnBus(CHANNEL, {DRIVE: TMCM, SERVO: GENERIC}):
        for node in nodes.values():
            network.add_node(node)
            node.sdo.RESPONSE_TIMEOUT = 5.0
        yield nodes


@pytest.fixture
def ours(network):
    """Return our client on their LocalNode, and that node."""
    node = canopen.LocalNode(THEIRS, dictionary(GENERIC, THEIRS))
    network.add_node(node)
    with DirectBus.open(CHANNEL, timeout_s=5.0) as bus:
        yield bus, node


# --- their client, our virtual drive


ERRORS = 0x1003


def test_their_client_reads_every_readable_object_as_our_dictionary_types_it(theirs):
    for node_id, eds in ((DRIVE, TMCM), (SERVO, GENERIC)):
        od, sdo = read_eds(data_path("eds", eds), node_id).od, theirs[node_id].sdo
        read = 0
        for entry in od:
            if entry.index == ERRORS and entry.subindex:  # empty: there is no data (CiA 301, 7.5.2.4)
                with pytest.raises(canopen.SdoAbortedError, match="0x08000024"):
                    sdo.upload(*entry.address)
            elif entry.readable:
                data = sdo.upload(*entry.address)
                decode(data, entry.data_type)  # its length is the type's
                read += 1
        assert read > 100


def test_their_client_writes_and_reads_numbers_by_name(theirs):
    node = theirs[DRIVE]
    node.sdo["Profile velocity"].raw = 1234
    assert node.sdo["Profile velocity"].raw == 1234
    node.sdo[0x60C2][2].raw = -3
    assert node.sdo[0x60C2][2].raw == -3
    assert node.sdo[0x1008].raw == "TMCM-1270"
    assert node.sdo[0x1018]["Vendor-ID"].raw == 0x286


def test_their_client_is_not_offered_the_switch_that_it_refuses(theirs):
    # It asks with a threshold of 0, which forbids a server to answer a block upload plainly.
    with theirs[SERVO].sdo.open(0x1000, 0, "rb", block_transfer=True) as file:
        assert file.read() == (0x20192).to_bytes(4, "little")


# --- our client, their LocalNode


def test_our_client_falls_back_if_their_server_has_no_block_transfer(ours):
    bus, node = ours
    bus.write(THEIRS, 0x2000, 0, content(1000), block=True)  # refused with 0x05040001: done again in segments
    assert node.get_data(0x2000, 0) == content(1000)
    assert bus.client(THEIRS).block_supported is False
    fresh = DirectBus.open(CHANNEL, timeout_s=5.0)
    with fresh:
        assert fresh.read(THEIRS, 0x2000, block=True) == content(1000)  # answered as if plainly asked


@pytest.mark.parametrize(
    ("index", "value", "data_type"),
    [(0x607A, -123_456, DataType.INTEGER32), (0x6060, -1, DataType.INTEGER8), (0x6040, 0x8006, DataType.UNSIGNED16)],
)
def test_numbers_mean_the_same_on_both_sides(ours, index, value, data_type):
    bus, node = ours
    bus.write(THEIRS, index, 0, encode(value, data_type))
    assert node.sdo[index].raw == value
    node.sdo[index].raw = value + 1
    assert decode(bus.read(THEIRS, index), data_type) == value + 1


def test_many_requests_in_a_row_find_their_own_answers(ours):
    bus, node = ours
    for number in range(300):
        node.set_data(0x607A, 0, number.to_bytes(4, "little"))
        assert bus.read(THEIRS, 0x607A) == number.to_bytes(4, "little")
        assert bus.read(THEIRS, 0x1000) == (0x20192).to_bytes(4, "little")
    assert (bus.client(THEIRS).ignored, bus.client(THEIRS).retried) == (0, 0)


def test_a_node_that_left_is_a_timeout(ours, network):
    bus, _ = ours
    network[THEIRS].remove_network()
    bus.timeout_s = 0.1
    with DirectBus.open(CHANNEL, timeout_s=0.05, retries=0) as quick, pytest.raises(SdoTimeout):
        quick.read(THEIRS, 0x1000)


def test_their_lss_and_other_messages_do_not_confuse_our_client(ours, network):
    bus, _ = ours
    network.bus.send(
        can.Message(arbitration_id=0x580 + THEIRS, data=bytes(8), is_extended_id=False)
    )  # belongs to nothing
    assert bus.read(THEIRS, 0x1000) == (0x20192).to_bytes(4, "little")
