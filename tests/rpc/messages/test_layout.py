from canopen_control.rpc.messages.layout import BusLayout, Layout, MappedEntry, NodeLayout, PdoLayout
from canopen_control.rpc.wire import convert, plain


def test_a_layout_comes_back_from_a_file_as_it_was():
    entry = MappedEntry(0x6041, 0, 16, "UNSIGNED16", "Statusword")
    node = NodeLayout("left", 3, "/x/a.eds", (PdoLayout(0x183, "tpdo", 1, 255, (entry,)),))
    layout = Layout({"can": BusLayout("local:x", 1_000_000, 1, nodes=(node,))})
    assert convert(plain(layout), Layout) == layout


def test_an_older_recording_may_lack_names():
    found = convert({"name": "left", "node_id": 3, "eds": None, "pdos": []}, NodeLayout)
    assert (found.eds, found.pdos) == (None, ())
