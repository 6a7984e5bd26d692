import pytest
from support.store import STORE, Changed, Get, Put, Value

from canopen_control.rpc.messages.declare import (
    BitRate,
    Bits,
    Count,
    Effect,
    Identifier,
    Index,
    NodeId,
    Refusal,
    Request,
    Subindex,
    UnixTime,
)
from canopen_control.rpc.wire import convert, decode


def test_a_declaration_is_a_method_with_request_answer_effect_and_text():
    method = STORE.of(Get)
    assert (method.name, method.request, method.answer, method.effect) == ("get", Get, Value, Effect.READS)
    assert method.text == "The value of a key."
    assert list(STORE.methods) == ["get", "put"]


def test_what_is_pushed_has_its_key():
    assert STORE.key_of(Changed) == "changed"


def test_a_request_is_frozen_and_refuses_what_it_does_not_declare():
    with pytest.raises(AttributeError):
        Get("a").key = "b"
    with pytest.raises(ValueError, match="unknown field `x`"):
        convert({"key": "a", "x": 1}, Put)
    with pytest.raises(TypeError):
        Put("a", 1.0)


def test_a_request_that_was_not_declared_has_no_method():
    class Stray(Request[Value], frozen=True):
        pass

    with pytest.raises(KeyError):
        STORE.of(Stray)


def test_a_refusal_without_words_is_one_all_the_same():
    assert convert({}, Refusal) == Refusal("RemoteError", "refused without a reason")


@pytest.mark.parametrize(
    ("kind", "lowest", "highest"),
    [
        (Index, 0, 0xFFFF),
        (Subindex, 0, 0xFF),
        (NodeId, 1, 127),
        (Identifier, 0, 0xFFFFFFFF),
        (Bits, 0, 64),
        (BitRate, 1, (1 << 63) - 1),
        (Count, 0, (1 << 63) - 1),
        (UnixTime, 0, 99_999_999_999),
    ],
)
def test_a_number_is_taken_within_its_range_and_refused_beyond_it(kind, lowest, highest):
    for good in (lowest, highest):
        assert decode(str(good).encode(), kind) == good
    for bad in (lowest - 1, highest + 1, 10**40):
        with pytest.raises(ValueError, match=r"Expected|out of range"):
            decode(str(bad).encode(), kind)


@pytest.mark.parametrize("text", [b"true", b'"1"', b"null", b"1e999"])
def test_what_is_not_a_number_is_none(text):
    for kind in (Count, UnixTime):
        with pytest.raises(ValueError, match=r"Expected|out of range|NaN or an infinite number"):
            decode(text, kind)
