"""PEAK's traces in all their versions, after the examples of its own description: data, errors, status, counters."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.recordings import read_trc
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame

DATA = CanFrame(0x300, bytes.fromhex("00000000040000"))
REMOTE = CanFrame(0x100 | REMOTE_FLAG, bytes(3))


def error(classes, data):
    return CanFrame(ERROR_FLAG | classes, bytes.fromhex(data))


WARNING, OFF = error(0x004, "000C000000000000"), error(0x040, "0000000000000000")
UNHEARD = error(0x288, "0000801900000808")
STUFF = error(0x288, "0000840200000000")

V10 = """;   Start time: 11.09.2002 16:00:20.682
     1)      1841      0300  7  00 00 00 00 04 00 00
     2)      1842      0008  4  ERROR 00 19 08 08
     3)      1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT
     4)      1844      0100  3  RTR
"""
V11 = """;$FILEVERSION=1.1
;$STARTTIME=37704.5364870833
     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
     5)      1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT
     6)      1349.2  Error      0008  4  00 19 08 08
     7)      1352.7  Rx         0100  3  RTR
"""
V12 = """;$FILEVERSION=1.2
;$STARTTIME=39878.6772258947
     1)      1059.900  1  Rx         0300  7  00 00 00 00 04 00 00
     5)      1346.834  1  Warng  FFFFFFFF  4  00 00 00 10  BUSOFF
     6)      1349.222  1  Error     0008  4  00 19 08 08
     7)      1352.743  1  Rx         0100  3  RTR
"""
V13 = """;$FILEVERSION=1.3
;$STARTTIME=40023.5245451516
     1)      1059.900 1  Rx        0300 -  7    00 00 00 00 04 00 00
     5)      1346.834 1  Warng FFFFFFFF -  4    00 00 00 08  BUSHEAVY
     6)      1349.222 1  Error     0008 -  4    00 19 08 08
     7)      1352.743 1  Rx        0100 -  3    RTR
"""
V20 = """;$FILEVERSION=2.0
;$STARTTIME=42209.4075997106
;$COLUMNS=N,O,T,I,d,l,D
      1      1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00
      5      1334.416 FD     0500 Tx 12 01 02 03 04 05 06 07 08 09 0A 0B 0C
      6      1334.522 ER          Rx    04 00 02 00 00
      7      1334.531 ST          Rx    00 00 00 08
      8      1334.643 EC          Rx    02 03
     10      1336.543 RR     0100 Rx 3
"""
V21 = """;$FILEVERSION=2.1
;$STARTTIME=41766.4648963872
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00
      6      1334.222 ER 1         - Rx -  5    04 00 02 00 00
      7      1334.224 EV 1  User-defined event for bus 1
      9      1334.231 ST 1         - Rx -  4    00 00 00 10
     11      1334.643 EC 1         - Rx -  2    02 03
     12      1335.156 DT 1  18EFC034 Tx -  8    01 02 03 04 05 06 07 08
     13      1336.543 RR 1      0100 Rx -  3
"""
COUNTERS = error(0x200, "0000000000000302")
LONG = CanFrame(0x18EFC034 | EXTENDED_FLAG, bytes(range(1, 9)))


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        (V10, [DATA, UNHEARD, WARNING, REMOTE]),
        (V11, [DATA, WARNING, UNHEARD, REMOTE]),
        (V12, [DATA, OFF, UNHEARD, REMOTE]),
        (V13, [DATA, WARNING, UNHEARD, REMOTE]),
        (V20, [DATA, None, STUFF, WARNING, COUNTERS, REMOTE]),
        (V21, [DATA, STUFF, None, OFF, COUNTERS, LONG, REMOTE]),
    ],
    ids=["1.0", "1.1", "1.2", "1.3", "2.0", "2.1"],
)
def test_every_row_is_a_frame_or_counted(text, frames):
    assert [each and each[1] for each in read_trc(io.StringIO(text))] == frames


def test_times_count_from_the_start_of_the_file():
    first, second, *_ = read_trc(io.StringIO(V11))
    assert abs(first[0] - (1_048_510_352_484_000_000 + 1_059_900_000)) < 10_000  # the day has ten decimals
    assert second[0] - first[0] == 286_900_000
    assert next(read_trc(io.StringIO(V10)))[0] == 1_841_000_000


@pytest.mark.parametrize(
    ("status", "detail"), [("00 00 00 00", "40"), ("00 00 00 02", "01"), ("00 04 00 00", "30"), ("00 04 00 08", "3C")]
)
def test_a_status_becomes_what_a_controller_of_linux_would_say(status, detail):
    text = [*V21.splitlines(keepends=True)[:3], f"      9      1334.231 ST 1         - Rx -  4    {status}\n"]
    [(_, frame)] = read_trc(io.StringIO("".join(text)))
    assert frame == error(0x004, f"00{detail}000000000000")


def test_a_row_that_is_cut_is_the_end():
    rows = read_trc(io.StringIO(V21.rstrip()[:-12]))
    with pytest.raises(EOFError):
        list(rows)


@given(st.text())
def test_no_text_is_another_error(text):
    list(read_trc(io.StringIO(V21 + text + "\n")))
