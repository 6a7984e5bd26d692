from __future__ import annotations

import pytest
from support.sdo import NODE, MemoryStore, conversations, frame, play_server

from canopen_control.cia301.sdo_server import SdoServer

CONVERSATIONS = conversations("""
a doubled request for a segment is answered once
    > 400720 < 410720000A > 60 >! 60 < 0030313233343536 > 70 < 19373839
a request for a segment that is repeated after its answer has not alternated, and the transfer is over
    > 400720 < 410720000A > 60 < 0030313233343536 > 60 < 8007200000000305 > 70 < 8000000001000405
a doubled request for the last segment is not an error
    > 400720 < 410720000A > 60 < 0030313233343536 > 70 < 19373839 >! 70
a doubled segment is taken once
    > 200820 < 600820 > 0031323334353637 >! 0031323334353637 < 20 > 1D38 < 30 >! 1D38 = 3132333435363738
a segment that is repeated after its confirmation has not alternated
    > 200820 < 600820 > 0031323334353637 < 20 > 0031323334353637 < 8008200000000305
another segment with the old toggle is an error
    > 200820 < 600820 > 0031323334353637 < 20 > 0D38 < 8008200000000305
more bytes than announced are refused and nothing is written
    > 2108200007 < 600820 > 0031323334353637 < 20 > 1D38 < 8008200012000706
fewer bytes than announced are refused and nothing is written
    > 2108200009 < 600820 > 0031323334353637 < 20 > 1D38 < 8008200013000706
one that grows over the limit is refused
    max_size=10 > 200820 < 600820 > 0031323334353637 < 20 > 1031323334353637 < 8008200005000405
the last segment is confirmed only when the store has taken the object
    size=4 > 200820 < 600820 > 053132333435 < 8008200012000706
""")


@pytest.mark.parametrize("words", CONVERSATIONS.values(), ids=CONVERSATIONS)
def test_the_conversations_of_the_server(words):
    play_server(words)


def test_the_object_is_read_once_and_does_not_change_under_way():
    server = SdoServer(NODE, MemoryStore({(0x2007, 0): b"0123456789"}))
    server.receive(frame("603#4007200000000000"), 0)
    server.store.objects[0x2007, 0] = b"changed while it was read"
    for request in ("603#6000000000000000", "603#7000000000000000"):
        server.frames()
        server.receive(frame(request), 0)
    assert server.frames() == [frame("583#1937383900000000")]
    assert server.store.uploads == 1
