"""Against the `canopen` package, which is written by others: our client on its server, its client on our server.

Known deviations of canopen 2.4: its server knows no block transfer (a block upload is answered as a plain one, a block
download with 0x05040001), answers a wrong length with 0x06070010 and checks no limits; its client does not accept a
plain answer to a block upload.
"""

from __future__ import annotations

import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes
from support.sdo import NODE, MemoryStore

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.frame import CanFrame

LENGTHS = [0, 1, 2, 3, 4, 5, 7, 8, 14, 889, 5000]


def dictionary():
    od = ObjectDictionary()
    for index, data_type in ((0x2000, datatypes.DOMAIN), (0x2001, datatypes.UNSIGNED16), (0x2002, datatypes.UNSIGNED8)):
        variable = ODVariable(f"object {index:X}", index)
        variable.data_type = data_type
        variable.access_type = "ro" if index == 0x2002 else "rw"
        variable.default = 5
        od.add_object(variable)
    return od


class Wire(canopen.Network):
    """A network whose bus is a function call."""

    def __init__(self, take):
        super().__init__()
        self.take = take

    def send_message(self, can_id, data, remote=False):
        self.take(CanFrame(can_id, bytes(data)))


class TheirServer:
    def __init__(self):
        self.client = SdoClient(NODE)
        self.wire = Wire(lambda one: self.client.receive(one, 0))
        self.node = canopen.LocalNode(NODE, dictionary())
        self.wire.add_node(self.node)

    def run(self, request):
        while frames := self.client.frames():
            for can_id, data in frames:
                self.wire.notify(can_id, bytearray(data), 0.0)
        assert request.done
        return request


class TheirClient:
    def __init__(self, **options):
        self.store = MemoryStore({(0x2000, 0): b"", (0x2001, 0): b"\0\0"})
        self.store.sizes[0x2001, 0] = 2
        self.server = SdoServer(NODE, self.store, **options)
        self.wire = Wire(self.take)
        self.node = canopen.RemoteNode(NODE, dictionary())
        self.wire.add_node(self.node)
        self.sdo = self.node.sdo
        self.initiates = set()

    def take(self, one):
        self.initiates.add(one.data[0] & 0xF3)
        self.server.receive(one, 0)
        for can_id, data in self.server.frames():
            self.wire.notify(can_id, bytearray(data), 0.0)


@pytest.mark.parametrize("block", [False, True])
@pytest.mark.parametrize("length", [length for length in LENGTHS if length])
def test_our_client_moves_any_length_on_their_server(length, block):
    pair, data = TheirServer(), bytes(n % 251 for n in range(length))
    written = pair.run(pair.client.write(0x2000, 0, data, block=block))
    read = pair.run(pair.client.read(0x2000, 0, block=block))
    assert (written.error, read.error, read.data) == (None, None, data)
    assert pair.node.get_data(0x2000, 0) == data


@pytest.mark.parametrize(
    ("index", "subindex", "code"), [(0x3000, 0, 0x06020000), (0x2002, 0, 0x06010002), (0x2001, 0, 0x06070010)]
)
def test_our_client_decodes_their_aborts(index, subindex, code):
    pair = TheirServer()
    request = pair.run(pair.client.write(index, subindex, b"\1\2\3\4"))
    assert request.error.code == code


@pytest.mark.parametrize("length", LENGTHS)
def test_their_client_moves_any_length_on_our_server(length):
    pair, data = TheirClient(), bytes(n % 251 for n in range(length))
    pair.sdo.download(0x2000, 0, data)
    assert pair.store.objects[0x2000, 0] == data
    assert pair.sdo.upload(0x2000, 0) == data


@pytest.mark.parametrize("block_size", [1, 4, 127])
@pytest.mark.parametrize("crc", [True, False])
@pytest.mark.parametrize("length", [7, 8, 889, 5000])
def test_their_client_uses_our_block_transfer(length, crc, block_size):
    pair, data = TheirClient(block_size=block_size), bytes(n % 251 for n in range(length))
    with pair.sdo.open(0x2000, 0, "wb", size=length, block_transfer=True, request_crc_support=crc) as file:
        for start in range(0, length, 7):  # its own writer cannot cut into segments itself
            file.write(data[start : start + 7])
    assert pair.store.objects[0x2000, 0] == data
    with pair.sdo.open(0x2000, 0, "rb", block_transfer=True, request_crc_support=crc) as file:
        assert file.read() == data
    assert pair.initiates >= {0xC2, 0xA0}  # without the CRC bit


def test_their_client_decodes_our_aborts():
    pair = TheirClient()
    with pytest.raises(canopen.SdoAbortedError) as missing:
        pair.sdo.upload(0x3000, 0)
    with pytest.raises(canopen.SdoAbortedError) as long:
        pair.sdo.download(0x2001, 0, b"\1\2\3\4")
    assert (missing.value.code, long.value.code) == (0x06020000, 0x06070012)
