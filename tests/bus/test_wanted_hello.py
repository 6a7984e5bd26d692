"""The greeting on a local bus survives any label, and nothing else is taken for one."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.wanted import HELLO_SIZE, LABEL_SIZE, MAGIC, VERSION, pack_hello, parse_hello
from canopen_control.frame import RECORD_SIZE


@given(st.integers(0, 2**32 - 1), st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=80))
def test_a_greeting_comes_back_with_its_label_cut_between_characters(pid, label):
    hello = parse_hello(pack_hello(pid, label))
    assert (hello.version, hello.pid) == (VERSION, pid)
    fitting = max(end for end in range(len(label) + 1) if len(label[:end].encode()) <= LABEL_SIZE)
    assert hello.label == label[:fitting]


@given(st.binary(min_size=HELLO_SIZE, max_size=HELLO_SIZE))
def test_garbage_is_no_greeting(data):
    assert (parse_hello(data) is None) is (data[:8] != MAGIC)


def test_a_greeting_has_the_length_of_whole_records():
    assert HELLO_SIZE % RECORD_SIZE == 0
    assert parse_hello(pack_hello(1, "a")[:-1]) is None
