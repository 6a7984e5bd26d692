"""The dialect of CANopenNode, row by row as measured: requests, and the resulting frames and answers."""

import pytest

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.gateway.dialect import (
    MAX_LINE,
    GatewayDialect,
    GatewayRefusal,
    LogOrder,
    LssOrder,
    NmtOrder,
    ReadOrder,
    WriteOrder,
    shown_value,
)


def events(data, dialect=None, **how):
    dialect = dialect or GatewayDialect(**how)
    dialect.receive(data if isinstance(data, bytes) else data.encode())
    return list(iter(dialect.next_event, None))


def one(line, **how):
    (event,) = events(f"{line}\n", **how)
    return event


@pytest.mark.parametrize(
    ("line", "request_"),
    [
        ("[1] 4 r 0x1000 0", ReadOrder(4, 0x1000, 0, "hex")),
        ("[1] 4 read 4096 0 U32", ReadOrder(4, 0x1000, 0, "u32")),
        ("  [1]\t1 0x04  READ 010000 00 vs  # comment\r", ReadOrder(4, 0x1000, 0, "vs")),
        ("[1] 4 start", NmtOrder(4, NmtCommand.START)),
        ("[1] 0 stop # all", NmtOrder(0, NmtCommand.STOP)),
        ("[1] 4 preop", NmtOrder(4, NmtCommand.ENTER_PRE_OPERATIONAL)),
        ("[1] 4 PreOperational", NmtOrder(4, NmtCommand.ENTER_PRE_OPERATIONAL)),
        ("[1] 4 reset node", NmtOrder(4, NmtCommand.RESET_NODE)),
        ("[1] 4 reset comm", NmtOrder(4, NmtCommand.RESET_COMMUNICATION)),
        ("[1] 4 reset communication", NmtOrder(4, NmtCommand.RESET_COMMUNICATION)),
        ("[1] 010 start", NmtOrder(8, NmtCommand.START)),  # octal, as in C
        ("[1] lss_switch_glob 1", LssOrder("lss_switch_glob", (1,))),
        ("[1] lss_switch_sel 1 2 3 0xFFFFFFFF", LssOrder("lss_switch_sel", (1, 2, 3, 0xFFFFFFFF))),
        ("[1] lss_set_node 255", LssOrder("lss_set_node", (255,))),
        ("[1] lss_conf_bitrate 0 9", LssOrder("lss_conf_bitrate", (0, 9))),
        ("[1] lss_activate_bitrate 100", LssOrder("lss_activate_bitrate", (100,))),
        ("[1] lss_store", LssOrder("lss_store", ())),
        ("[1] lss_inquire_addr", LssOrder("lss_inquire_addr", ())),
        ("[1] 1 lss_inquire_addr 3", LssOrder("lss_inquire_addr", (3,))),
        ("[1] lss_get_node", LssOrder("lss_get_node", ())),
        ("[1] _lss_fastscan 20", LssOrder("_lss_fastscan", (20,))),
        ("[1] lss_allnodes", LssOrder("lss_allnodes", ())),
        ("[1] lss_allnodes 20 5 0", LssOrder("lss_allnodes", (20, 5, 0))),
        ("[1] lss_allnodes 0 5 1 2 1 0 0 1 0 2 9", LssOrder("lss_allnodes", (0, 5, 1, 2, 1, 0, 0, 1, 0, 2, 9))),
        ("[1] log", LogOrder()),
    ],
)
def test_a_command_is_a_request(line, request_):
    assert one(line) == request_


@pytest.mark.parametrize(
    ("value", "data"),
    [
        ("i8 -1", b"\xff"),
        ("u16 0x1234", b"\x34\x12"),
        ("x32 010", b"\x08\0\0\0"),
        ("i64 -2", b"\xfe" + b"\xff" * 7),
        ("b 0x81", b"\x81"),
        ("r32 1.5", b"\0\0\xc0\x3f"),
        ("r64 -2e1", b"\0\0\0\0\0\0\x34\xc0"),
        ('vs "hello ""x"" world"', b'hello "x" world'),
        ("vs hello", b"hello"),
        ('vs "with # and ü" # comment', "with # and ü".encode()),
        ("hex 01 02", b"\x01\x02"),
        ("hex 0102", b"\x01\x02"),
        ("hex 1 2 3 # comment", b"\x01\x02\x03"),
        ("d MTL+/zQ1NsA=", b"12\xfe\xff456\xc0"),
        ("os MTI", b"12"),
        ("us MTI= # comment\r", b"12"),
    ],
)
def test_a_value_is_written_by_its_type(value, data):
    assert one(f"[1] 4 w 0x2000 1 {value}") == WriteOrder(4, 0x2000, 1, data)


@pytest.mark.parametrize(
    ("type_name", "data", "shown"),
    [
        ("hex", "92 01 FF FF", "92 01 FF FF"),
        ("u32", "92 01 FF FF", "4294902162"),
        ("i32", "92 01 FF FF", "-65134"),
        ("x32", "92 01 FF FF", "0xFFFF0192"),
        ("u16", "92 01 FF FF", "92 01 FF FF"),
        ("x8", "05", "0x05"),
        ("x64", "01 00 00 00 00 00 00 00", "0x0000000000000001"),
        ("b", "81", "129"),
        ("r32", "00 00 C0 3F", "1.5"),
        ("r64", "C3 F5 28 5C 8F 36 36 C0", "-22.2131"),
        ("d", "31 32 FE FF 34 35 36 C0", "MTL+/zQ1NsA="),
        ("os", "", ""),
        ("vs", "", '""'),
        ("vs", "41 20 22 62 22 20 63 0D 0A 64 00", '"A ""b"" c\nd"'),
    ],
)
def test_a_value_is_shown_by_its_type(type_name, data, shown):
    assert shown_value(type_name, bytes.fromhex(data)) == shown


@pytest.mark.parametrize(
    ("line", "number"),
    [
        *((line, 101) for line in ("[7] 4 start now", "[7]", "[7] 4", "[7] 1 2 3 start", "[7] 4 r", "[7] 4 r 0x1000")),
        *((line, 101) for line in ("[7] 4 r 0x10000 0", "[7] 4 r 0x1000 256", "[7] 4 r 0x1000 0 t", "[7] 4 reset")),
        *((line, 101) for line in ("[7] 4 r 0x1000 0 td", "[7] 4 r 0x1000 0 u8 x", "[7] 4 reset all", "[7] 4x start")),
        *((f"[7] 4 w 0x1000 0 {value}", 101) for value in ("u8 -1", "u16 70000", "u32 4294967296", "q8 1", "u8")),
        *((f"[7] 4 w 0x1000 0 {value}", 101) for value in ('vs "a', "vs a b", 'vs a"b', 'vs "a"b', 'vs ""', "vs")),
        *((f"[7] 4 w 0x1000 0 {value}", 101) for value in ("hex 0g", "hex # 01", "d M", "d M*", "r32 x", "r32 1e99")),
        *((f"[7] set {words}", 101) for words in ("node 0", "node 128", "node", "sdo_timeout 0", "sdo_block 2")),
        *((f"[7] {words}", 101) for words in ("lss_set_node 128", "lss_set_node 0", "lss_conf_bitrate 0 5")),
        *((f"[7] {words}", 101) for words in ("lss_conf_bitrate 1 1", "lss_allnodes 1 2", "lss_store 1")),
        *((f"[7] {words}", 101) for words in ("help me", "log 1", "led 1", "start_a_word_that_is_longer_than_20")),
        *((f"[7] {words}", 100) for words in ("bogus", "set command_timeout 5", "info version", "boot_up_indication")),
        *((f"[7] {words}", 105) for words in ("r 0x1000 0", "start", "w 0x1000 0 u8 1", "reset node")),
        *((f"[7] {words}", 107) for words in ("128 start", "0 r 0x1000 0", "0 w 0x1000 0 u8 1", "1 200 start")),
        ("[7] 65536 4 start", 106),
    ],
)
def test_what_is_not_a_command_is_an_error(line, number):
    dialect = GatewayDialect()
    dialect.sequence = 7
    assert events(f"{line}\n", dialect) == [dialect.error(GatewayRefusal(number))]
    assert dialect.error(GatewayRefusal(number)).startswith(f"[7] ERROR:{number} #".encode())


def test_a_bad_sequence_number_has_the_one_before_or_0_in_its_answer():
    dialect = GatewayDialect()
    lines = ["[9] bogus", "start", "54 start", "[ 55 ] 4 start", "[x] start", "start"]
    answers = [events(f"{line}\n", dialect)[0].split(b" #")[0] for line in lines]
    assert answers == [b"[9] ERROR:100", *[b"[9] ERROR:101"] * 3, *[b"[0] ERROR:101"] * 2]


@pytest.mark.parametrize(
    ("number", "shown"), [("4294967295", "-1"), ("4294967296", "0"), ("0x10", "16"), ("", "0"), ("07", "7")]
)
def test_a_sequence_number_is_printed_as_cangopennode_prints_it(number, shown):
    dialect = GatewayDialect()
    assert events(f"[{number}] set node 4\n", dialect) == [f"[{shown}] OK\r\n".encode()]


def test_defaults_are_kept_for_the_client():
    dialect = GatewayDialect()
    lines = "[1] set node 4\n[2] set sdo_timeout 1000\n[3] 7 set sdo_block 1\n[4] set network 2\n[5] r 0x1000 0\n"
    assert events(lines, dialect)[-1] == ReadOrder(4, 0x1000, 0, "hex")
    assert (dialect.timeout_ms, dialect.block) == (1000, True)


def test_answers_end_with_cr_lf_and_errors_have_no_blank_after_the_colon():
    dialect = GatewayDialect()
    dialect.sequence = 19
    assert dialect.ok() == b"[19] OK\r\n"
    assert dialect.abort(0x06020000) == b"[19] ERROR:0x06020000 #Object does not exist.\r\n"
    assert dialect.abort(0x05040000) == b"[19] ERROR:0x05040000 #SDO protocol timed out.\r\n"
    assert dialect.error(GatewayRefusal(105)) == b"[19] ERROR:105 #No default node set.\r\n"
    assert dialect.error(GatewayRefusal(102, "two\r\nlines")).endswith(b"internal state. two lines\r\n")
    assert dialect.log(["a", "b"]) == b"a\nb\r\n"


def test_lines_without_a_command_help_and_led():
    assert events(b"\n\r\n# comment \0\xff\n   \n") == [b"\r\n"] * 4
    for topic in ("", " datatype", " LSS"):
        text = one(f"[1] help{topic}")
        assert (text[:1], text[-2:], text.count(b"\r")) == (b"\n", b"\r\n", 1)
    assert one("[1] led") == b" CANopen status LEDs: R  G         \r"


def test_typed_requests_need_no_sequence_number():
    assert one("4 start", optional_sequence=True) == NmtOrder(4, NmtCommand.START)
    assert events(b"# c\n\n[3] set node 5\n", optional_sequence=True) == [b"\r\n", b"\r\n", b"[3] OK\r\n"]


def test_a_command_comes_in_pieces_and_half_of_one_is_none():
    dialect = GatewayDialect()
    assert events(b"[1] 4 st", dialect) == []
    assert dialect.unfinished
    assert events(b"art\n[2]", dialect) == [NmtOrder(4, NmtCommand.START)]
    assert events(b" 4 stop\n", dialect) == [NmtOrder(4, NmtCommand.STOP)]
    assert not dialect.unfinished


def test_bytes_that_are_not_text_are_an_error_outside_of_a_comment():
    for line in (b"\0\n", b"[1] 4 st\0art\n", b"\xff\xfe\n", b"[1] 4 start\x7f\n", b'[1] 4 w 0x1000 0 vs "\0"\n'):
        assert b"ERROR:101" in events(line)[0]


def test_a_line_that_is_too_long_is_one_error_and_the_next_is_served():
    dialect = GatewayDialect()
    pieces = [b"[5] 4 start\n[6] ", *[b"x" * 10_000] * 8, b"\n[7] 4 stop\n"]
    result = [event for piece in pieces for event in events(piece, dialect)]
    limits = b"65536 bytes, 16777216 to write a text, hex or base64 value"
    error = b"[5] ERROR:101 #Syntax error. The line is longer than %s.\r\n" % limits
    assert result == [NmtOrder(4, NmtCommand.START), error, NmtOrder(4, NmtCommand.STOP)]


def test_the_value_of_a_domain_may_be_longer_than_a_line():
    data = b"QUJD" * MAX_LINE
    (request,) = events(b"[1] 4 w 0x1F50 1 d " + data + b"\n")
    assert request == WriteOrder(4, 0x1F50, 1, b"ABC" * MAX_LINE)
