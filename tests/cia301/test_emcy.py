from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from support.services import MS, frame, vectors

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import (
    EmcyConsumer,
    EmcyMessage,
    EmcyProducer,
    ErrorRegister,
    error_text,
    register_text,
)
from canopen_control.frame import CanFrame


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x0000, "error reset or no error"),
        (0x00FF, "error reset or no error"),
        (0x8611, "following error"),
        (0x8130, "life guard or heartbeat error"),
        (0x7121, "motor blocked"),
        (0x6301, "data set"),
        (0x5443, "contacts"),
        (0x8199, "communication"),
        (0xFF01, "device specific"),
        (0xF0AA, "additional functions"),
        (0x9123, "external error"),
        (0x0123, "unknown error code 0x0123"),
        (0xA000, "unknown error code 0xA000"),
    ],
)
def test_a_code_has_its_text_or_that_of_its_class(code, text):
    assert error_text(code) == text


def test_every_code_has_some_text():
    assert all(error_text(code) for code in range(0x10000))


def test_the_register_bits_are_the_vectors():
    bits = vectors()["emcy"]["register_bits"]
    assert {int(bit): name for bit, name in bits.items() if not name.startswith("reserved")} == {
        int(flag).bit_length() - 1: register_text(flag) for flag in ErrorRegister if flag
    }
    assert register_text(0x21) == "generic, device profile"
    assert register_text(0) == ""


EMCY = vectors()["emcy"]
PROFILE, COMMUNICATION = ErrorRegister.DEVICE_PROFILE, ErrorRegister.COMMUNICATION


@pytest.mark.parametrize("vector", EMCY["vectors"], ids=lambda v: v["frame"])
def test_messages_are_the_vectors_both_ways(vector):
    message = EmcyMessage(
        vector["node"], int(vector["code"], 16), int(vector["register"], 16), bytes.fromhex(vector["ms"])
    )
    assert EmcyMessage.parse(frame(vector["frame"])) == message
    assert message.encode() == frame(vector["frame"])
    assert message.is_reset == (message.error_code == 0)


@pytest.mark.parametrize("text", EMCY["malformed"])
def test_malformed_messages_are_none(text):
    assert EmcyMessage.parse(frame(text)) is None
    consumer = EmcyConsumer(frame(text).can_id & 0x7F or 3)
    consumer.receive(frame(text), 0)
    assert (consumer.events(), consumer.active) == ([], ())
    assert consumer.malformed == (not text.startswith("080"))


def test_a_short_message_keeps_what_came():
    message = EmcyMessage.parse(frame("083#118621AABB"))
    assert message == EmcyMessage(3, 0x8611, 0x21, b"\xaa\xbb")
    assert message.encode() == frame("083#118621AABB000000")


def test_a_message_reads_as_a_sentence():
    assert str(EmcyMessage(3, 0x8611, 0x21)) == "0x8611 (following error), register 0x21"
    assert str(EmcyMessage(3, 0xFF01, 0x81, b"\3\0\0\0\0")).endswith("register 0x81, data 03 00 00 00 00")


def test_an_error_is_sent_once_with_the_generic_bit_added():
    producer = EmcyProducer(3)
    assert producer.raise_error(0x8611, PROFILE, 0, bytes.fromhex("0102030405"))
    assert not producer.raise_error(0x8611, PROFILE, 1)
    assert producer.frames() == [frame(EMCY["vectors"][0]["frame"])]
    assert (producer.error_register, producer.active) == (0x21, (0x8611,))


LENGTH_ERRORS = ["083#1082110000000000", "083#2082110000000000", vectors()["sync"]["wrong_length"]["emcy"]]


@pytest.mark.parametrize("text", LENGTH_ERRORS)
def test_a_report_is_taken_back_at_once(text):
    producer, code = EmcyProducer(3), int.from_bytes(frame(text).data[:2], "little")
    producer.report(code, 0, register=COMMUNICATION)
    assert producer.frames() == [frame(text), frame("083#0000000000000000")]
    assert (producer.error_register, producer.active, producer.history) == (0, (), (code,))


def test_a_report_of_what_is_active_already_reports_and_clears_nothing():
    producer = EmcyProducer(3)
    producer.raise_error(0x8110, COMMUNICATION, 0)
    producer.frames()
    producer.report(0x8110, 1, register=COMMUNICATION)
    assert (producer.frames(), producer.active) == ([], (0x8110,))


class Line(RuleBasedStateMachine):
    """A producer and who hears it: register, history, frames and what the consumer keeps never disagree."""

    def __init__(self):
        super().__init__()
        self.producer, self.consumer, self.raised = EmcyProducer(3, history_size=64), EmcyConsumer(3), []

    def hear(self):
        for sent in self.producer.frames():
            self.consumer.receive(sent, 0)

    @rule(code=st.integers(0x1000, 0x1007), bit=st.integers(1, 7))
    def an_error_comes(self, code, bit):
        if self.producer.raise_error(code, 1 << bit, 0):
            self.raised.append(code)

    @rule(code=st.integers(0x1000, 0x1007))
    def an_error_goes(self, code):
        self.producer.clear_error(code, 0)

    @rule(code=st.integers(0x2000, 0x2003), bit=st.integers(1, 7))
    def something_happens(self, code, bit):
        self.producer.report(code, 0, register=1 << bit)
        self.raised.append(code)

    @rule()
    def all_is_well(self):
        for code in self.producer.active:
            self.producer.clear_error(code, 0)

    @invariant()
    def one_truth(self):
        self.hear()
        assert self.consumer.register == self.producer.error_register
        assert set(self.consumer.active) >= set(self.producer.active)
        assert bool(self.consumer.active) == bool(self.producer.active)
        assert self.producer.history == tuple(reversed(self.raised[-64:]))


TestOneTruth = Line.TestCase


def test_a_consumer_clears_errors_that_a_later_emcy_shows_as_gone():
    consumer = EmcyConsumer(3)
    for text in ("083#1082110000000000", "083#1042090000000000"):  # 0x8210 with bit 4, then 0x4210 without it
        consumer.receive(frame(text), 0)
    assert consumer.active == (0x4210,)


def test_an_error_that_comes_again_with_another_bit_is_not_forgotten_with_the_first():
    producer, consumer = EmcyProducer(3), EmcyConsumer(3)
    producer.raise_error(0x1000, 1 << 1, 0)
    producer.raise_error(0x1001, 1 << 1, 0)
    producer.raise_error(0x1002, 1 << 2, 0)
    producer.clear_error(0x1000, 0)  # only the node can determine that it was this one
    producer.raise_error(0x1000, 1 << 2, 0)
    producer.clear_error(0x1001, 0)
    for sent in producer.frames():
        consumer.receive(sent, 0)
    assert set(consumer.active) == set(producer.active) == {0x1000, 0x1002}


def test_an_error_without_any_bit_stays_until_an_error_reset():
    consumer = EmcyConsumer(3)
    for text in ("083#1082000000000000", "083#1042000000000000"):
        consumer.receive(frame(text), 0)
    assert consumer.active == (0x8210, 0x4210)
    consumer.receive(frame("083#0000000000000000"), 0)
    assert consumer.active == ()


def test_a_cleared_error_reports_what_remains():
    producer = EmcyProducer(3)
    producer.raise_error(0x8611, PROFILE, 0)
    producer.raise_error(0x8130, COMMUNICATION, 0)
    producer.frames()
    assert producer.clear_error(0x8611, 1)
    assert not producer.clear_error(0x8611, 2)
    assert producer.frames() == [frame("083#0000110000000000")]
    assert producer.clear_error(0x8130, 3)
    assert producer.frames() == [frame("083#0000000000000000")]
    assert producer.error_register == 0


def test_the_inhibit_time_spaces_messages_to_the_nanosecond_and_keeps_their_order():
    producer = EmcyProducer(3, inhibit_ns=100)
    for code in (0x1000, 0x2000, 0x3000):
        producer.raise_error(code, 1, 0)
    assert [f.data[1] for f in producer.frames()] == [0x10]
    assert producer.next_deadline() == 100
    producer.tick(99)
    assert producer.frames() == []
    producer.tick(100)
    assert ([f.data[1] for f in producer.frames()], producer.next_deadline()) == ([0x20], 200)
    producer.tick(500)
    assert ([f.data[1] for f in producer.frames()], producer.next_deadline()) == ([0x30], None)
    producer.raise_error(0x4000, 1, 550)
    assert producer.frames() == []
    producer.tick(600)
    assert len(producer.frames()) == 1


def test_a_flood_within_the_inhibit_time_is_bounded_and_counted():
    producer = EmcyProducer(3, inhibit_ns=100, queue_limit=4)
    for code in range(50):
        producer.raise_error(0x1000 + code, 1, 0)
    assert producer.lost == 45
    producer.tick(10**9)
    assert len(producer.frames()) == 2  # the first, and one of those that waited


def test_the_history_is_newest_first_bounded_and_cleared_by_zero_only():
    producer = EmcyProducer(3, history_size=2)
    producer.raise_error(0x1000, 1, 0)
    producer.report(0x8611, 0, b"\x34\x12\xff")
    producer.report(0x8130, 0)
    assert producer.history == (0x00008130, 0x12348611)
    assert [producer.read_history(sub) for sub in (0, 1, 2, 3)] == [2, 0x8130, 0x12348611, None]
    assert producer.write_history_count(1) is AbortCode.INVALID_VALUE
    assert len(producer.history) == 2
    assert producer.write_history_count(0) is None
    assert (producer.history, producer.read_history(0)) == ((), 0)


@pytest.mark.parametrize("switch", ["enabled", "allowed"])
def test_what_may_not_be_sent_reaches_register_and_history_only(switch):
    producer = EmcyProducer(3)
    setattr(producer, switch, False)
    producer.raise_error(0x1000, 1, 0)
    producer.tick(0)
    assert (producer.frames(), producer.error_register, producer.history) == ([], 1, (0x1000,))


def test_waiting_messages_are_dropped_where_the_state_carries_none():
    producer = EmcyProducer(3, inhibit_ns=100)
    producer.raise_error(0x1000, 1, 0)
    producer.raise_error(0x2000, 1, 0)
    producer.allowed = False
    producer.tick(100)
    assert len(producer.frames()) == 1
    assert producer.next_deadline() is None


def test_the_cob_id_can_be_changed_and_reset_clears_all():
    producer = EmcyProducer(3, inhibit_ns=100)
    producer.cob_id = 0x90
    producer.raise_error(0x1000, 1, 0)
    producer.raise_error(0x2000, 2, 0)
    assert [f.can_id for f in producer.frames()] == [0x90]
    producer.reset()
    assert (producer.active, producer.history, producer.next_deadline()) == ((), (), None)


def test_the_consumer_keeps_register_and_active_errors_of_its_node():
    consumer = EmcyConsumer(3)
    assert (consumer.active, consumer.register) == ((), 0)
    consumer.receive(frame("083#1186210000000000"), 1)
    consumer.receive(frame("083#30813100FF000000"), 2)
    consumer.receive(frame("084#1043090000000000"), 3)
    assert [message.error_code for message in consumer.events()] == [0x8611, 0x8130]
    assert (consumer.active, consumer.register) == ((0x8611, 0x8130), 0x31)


def test_an_error_reset_with_a_register_keeps_the_other_errors():
    consumer = EmcyConsumer(3)
    consumer.receive(frame("083#1186210000000000"), 0)
    consumer.receive(frame("083#3081310000000000"), 0)
    consumer.receive(frame("083#0000110000000000"), 0)
    assert consumer.active == (0x8130,)
    consumer.receive(frame("083#0000000000000000"), 0)
    assert (consumer.active, consumer.register) == ((), 0)


def test_a_rebooted_node_has_no_active_errors():
    consumer = EmcyConsumer(3)
    consumer.receive(frame("083#1186210000000000"), 0)
    consumer.forget()
    assert (consumer.active, consumer.register) == ((), 0)


@pytest.mark.parametrize("length", range(9))
def test_three_to_eight_bytes_are_an_emergency(length):
    consumer = EmcyConsumer(3)
    data = bytes.fromhex("1186210102030405")[:length]
    consumer.receive(CanFrame(0x083, data), 0)
    received = [] if length < 3 else [EmcyMessage(3, 0x8611, 0x21, data[3:])]
    assert (consumer.events(), consumer.malformed) == (received, length < 3)


def test_a_flood_stays_bounded():
    consumer = EmcyConsumer(3, active_limit=4)
    for number in range(2000):
        data = (0x1000 + number).to_bytes(2, "little") + b"\1"
        consumer.receive(frame(f"083#{data.hex()}"), number * MS)
    assert consumer.active == tuple(range(0x1000 + 1996, 0x1000 + 2000)), "the newest"
    assert len(consumer.events()) + consumer.lost == 2000


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF)), max_size=100))
def test_the_active_errors_are_bounded_and_gone_with_the_register(messages):
    consumer = EmcyConsumer(3, active_limit=4)
    for code, register in messages:
        consumer.receive(EmcyMessage(3, code, register).encode(), 0)
        assert len(consumer.active) <= 4
    consumer.receive(frame("083#0000000000000000"), 0)
    assert consumer.active == ()
