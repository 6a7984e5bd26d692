"""The peer of the services bench: canopen as client, on our bus and on its own, moves what it is given."""

import pytest
from canopen_control_bench.peers.sdo_canopen import import_eds, their_client, their_virtual_client
from canopen_control_bench.services import check
from canopen_control_bench.stage import EDS, stage


@pytest.mark.process
def test_it_moves_blocks_on_both_buses():
    with stage() as played:
        played.start("canopen_control_bench.sdo_client").line()
        for opener in (their_client, their_virtual_client):
            with opener() as client:
                check(client, bytes(range(100)))


def test_it_reads_the_bundled_eds():
    assert len(import_eds(EDS, 3)) > 50
