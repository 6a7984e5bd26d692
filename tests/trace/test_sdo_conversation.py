import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.tracing import check_transcript, robby_decoder, said

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription
from canopen_control.trace.sdo_conversation import LIMIT


class Store:
    """An object store that takes and gives whatever is asked for."""

    def __init__(self, content=b""):
        self.content = content

    def upload(self, index, subindex):
        return self.content

    def download(self, index, subindex, data):
        self.content = bytes(data)

    def size_of(self, index, subindex):
        return None


def overheard(request, content=b"", decoder=None):
    """Let our client and our server talk, and return what a listener understood."""
    client, server = SdoClient(3), SdoServer(3, Store(content))
    request(client)
    decoder = decoder or Decoder(NetworkDescription())
    lines = []
    for _ in range(100_000):
        requested = client.frames()
        answered = []
        for item in requested:
            lines.append(decoder.decode(item))
            server.receive(item, 0)
            answered += server.frames()
        for item in answered:
            lines.append(decoder.decode(item))
            client.receive(item, 0)
        if not requested and not answered:
            break
        client.tick(0)
    assert [event.error for event in client.events()] == [None]
    return lines


def carried(lines):
    """Return the bytes of every value; eight bytes of an unknown type are shown as a number."""
    values = [value.value for line in lines for value in line.values]
    return [value.to_bytes(8, "little") if isinstance(value, int) else value for value in values]


def test_short_values_are_read_and_written_by_type_and_name():
    check_transcript("""
        603#4041600000000000 read 0x6041:00 Statusword
        583#4B41600037060000 0x6041:00 Statusword = 0x0637 OPERATION ENABLED, target reached
        603#2F60600003000000 write 0x6060:00 Modes of operation = 3 PV
        583#6060600000000000 written 0x6060:00 Modes of operation
    """)


def test_the_abort_names_object_code_and_side():
    check_transcript("""
        603#4018100500000000 read 0x1018:05 Identity object
        583#8018100511000906 ABORT by the node, 0x1018:05 Identity object: 0x06090011 subindex does not exist
        603#8008100000000405 ABORT by the client, 0x1008:00 Manufacturer device name: 0x05040000 SDO protocol timed out
    """)


def test_configuration_objects_are_reported_in_their_own_words():
    texts = said(
        robby_decoder(),
        (0x603, "23001A0110004160"),
        (0x603, "2300180183010080"),
        (0x603, "2F00180201000000"),
        (0x603, "2B17100064000000"),
        (0x603, "23161001F4010100"),
        (0x603, "2310100173617665"),
    )
    assert [text.rpartition(" = ")[2] for text in texts] == [
        "0x60410010 (0x6041:00 Statusword, 16 bits)",
        "0x80000183 (0x183, off)",
        "1 (every SYNC)",
        "100 ms",
        "0x000101F4 (node 1 within 500 ms)",
        "0x65766173 ('save')",
    ]


@settings(deadline=None, max_examples=examples(40))
@given(st.binary(min_size=5, max_size=600), st.booleans())
def test_segments_and_blocks_are_put_together(content, block):
    lines = overheard(lambda client: client.read(0x2000, 1, block=block), content)
    assert carried(lines) == [content]
    written = overheard(lambda client: client.write(0x2000, 1, content, block=block))
    assert carried(written) == [content]
    assert written[-1].text == "written 0x2000:01"


def test_a_string_in_segments_is_read_as_one():
    check_transcript("""
        603#4008100000000000 read 0x1008:00 Manufacturer device name
        583#4108100009000000 0x1008:00 Manufacturer device name: 9 bytes, in segments
        603#6000000000000000 next segment of 0x1008:00 Manufacturer device name
        583#00544D434D2D3132 segment of 0x1008:00 Manufacturer device name, 7 of 9 bytes
        603#7000000000000000 next segment of 0x1008:00 Manufacturer device name
        583#1B37300000000000 0x1008:00 Manufacturer device name = 'TMCM-1270'
    """)


def test_a_late_subscriber_is_notified():
    check_transcript("""
        583#00544D434D2D3132 segment of a transfer with unknown start
        603#6000000000000000 next segment of a transfer with unknown start
        583#C100000000000000 end of a block transfer with unknown start
    """)


def test_a_lost_block_segment_is_sent_again_and_counted_once():
    check_transcript(
        """
        603#A00020007F000000 read 0x2000:00 in blocks of 127 segments
        583#C20020000E000000 0x2000:00: 14 bytes, in blocks
        603#A300000000000000 send 0x2000:00
        583#0141424344454647 block segment 1 of 0x2000:00
        583#8248494A4B4C4D4E block segment 2 of 0x2000:00, the last
        603#A2017F0000000000 1 segments of 0x2000:00 acknowledged, 1 to be repeated
        583#8148494A4B4C4D4E block segment 1 of 0x2000:00, the last
        603#A2017F0000000000 1 segments of 0x2000:00 acknowledged
        583#C100000000000000 0x2000:00 = 41 42 43 44 45 46 47 48 49 4a 4b 4c 4d 4e
    """,
        Decoder(NetworkDescription()),
    )


def test_a_transfer_larger_than_what_is_kept_is_reported_by_its_length():
    content = bytes(LIMIT + 100)
    lines = overheard(lambda client: client.read(0x2000, 1, block=True), content)
    texts = [line.text for line in lines if " = " in line.text]
    assert texts == [f"0x2000:01 = {len(content)} bytes"]


@pytest.mark.parametrize("data", ["", "FF", "E0", "40"])
def test_what_is_not_a_sdo_is_reported(data):
    assert said(robby_decoder(), (0x603, data))[0]
