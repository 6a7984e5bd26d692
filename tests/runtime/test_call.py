from canopen_control.errors import ControlError
from canopen_control.runtime.call import Call


class Peer:
    name, pid = "#1", 7

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append(message)


def test_a_request_is_answered_under_its_number():
    peer = Peer()
    Call(peer, {}, 5).reply({"a": 1})
    Call(peer, {}, "x").refuse(ControlError("no"))
    Call(peer, {}, 6).settle(None)
    Call(peer, {}, 7).settle("late")
    assert peer.sent == [
        {"id": 5, "result": {"a": 1}},
        {"id": "x", "error": {"kind": "ControlError", "message": "no"}},
        {"id": 6, "result": {}},
        {"id": 7, "error": {"kind": "ControlError", "message": "late"}},
    ]


def test_a_notification_is_answered_by_nothing():
    peer = Peer()
    call = Call(peer, {}, None)
    call.reply({})
    call.refuse(ControlError("no"))
    assert peer.sent == []


def test_the_source_is_what_the_client_says_or_who_it_is():
    assert Call(Peer(), {"source": "ros"}, 1).source == "ros"
    assert Call(Peer(), {}, 1).source == "client #1 (pid 7)"
