from canopen_control.rpc.messages.layout import NodeLayout
from canopen_control.rpc.wire import convert


def test_an_older_recording_may_lack_names():
    result = convert({"name": "left", "node_id": 3, "eds": None, "pdos": []}, NodeLayout)
    assert (result.eds, result.pdos) == (None, ())
