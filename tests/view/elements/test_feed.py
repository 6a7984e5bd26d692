import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import visited

from canopen_control.view.elements.feed import Feed


def test_what_is_sent_goes_out_in_one_message(monkeypatch):
    called = []
    monkeypatch.setattr(Feed, "run_method", lambda self, name, *args: called.append((name, args)))

    async def act(_user, feed):
        feed.send({"scene": {"angles": [1.0]}, "lost": False})
        feed.send({})

    visited(Feed, act)
    assert called == [("take", ({"scene": {"angles": [1.0]}, "lost": False},)), ("take", ({},))]
