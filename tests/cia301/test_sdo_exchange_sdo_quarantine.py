from __future__ import annotations

from canopen_control.cia301.sdo_exchange import Quarantine

X, Y, TYPE, REGISTER = b"\0\x20\0", b"\1\x20\0", b"\0\x10\0", b"\1\x10\0"


def quarantine(*muxes):
    made = Quarantine()
    for mux in muxes:
        made.died(mux)
    return made


def test_an_answer_settles_all_that_was_asked_before():
    made = quarantine(X, Y)
    made.answered(TYPE)
    assert not made.owed


def test_an_answer_that_may_be_late_settles_only_what_was_asked_before_the_first_of_its_kind():
    made = quarantine(X, TYPE, Y, TYPE)
    made.answered(TYPE)
    assert list(made.owed) == [TYPE, Y]


def test_the_probe_is_one_that_is_owed_nothing():
    assert quarantine(X).probe()[1:4] == TYPE
    assert quarantine(X, TYPE).probe()[1:4] == REGISTER
    assert quarantine(REGISTER).probe()[1:4] == TYPE


def test_with_both_owed_the_later_one_settles_more():
    assert quarantine(TYPE, X, REGISTER).probe()[1:4] == REGISTER
    assert quarantine(REGISTER, X, TYPE).probe()[1:4] == TYPE


def test_two_probes_settle_everything_whatever_the_order():
    made = quarantine(TYPE, REGISTER, X)
    for _ in range(2):
        made.answered(made.probe()[1:4])
    assert not made.owed
