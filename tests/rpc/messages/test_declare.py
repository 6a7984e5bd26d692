import pytest
from support.store import STORE, Changed, Get, Put, Value

from canopen_control.rpc.messages.declare import Effect, Refusal, Request
from canopen_control.rpc.wire import convert


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
