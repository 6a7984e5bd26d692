"""The SDO server of the bench: a number, a block, nothing else."""

import pytest
from canopen_control_bench.sdo_client import BLOCK, BUS, NUMBER, Store, our_client
from canopen_control_bench.stage import stage

from canopen_control.cia301.sdo_server import SdoServerAbort


def test_the_store_has_a_number_and_a_block_and_refuses_the_rest():
    store = Store()
    store.download(*BLOCK, b"abc")
    assert store.upload(*BLOCK) == b"abc"
    assert store.upload(*NUMBER) == (0x20192).to_bytes(4, "little")
    with pytest.raises(SdoServerAbort):
        store.upload(0x2001, 0)


@pytest.mark.process
def test_our_client_reads_and_moves_blocks_on_the_bus():
    with stage() as played:
        played.start("canopen_control_bench.sdo_client").line()
        with our_client() as client:
            for block in (False, True):
                client.download(b"0123456789", block)
                assert client.upload(block) == b"0123456789"
    assert BUS
