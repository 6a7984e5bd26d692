import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import visited

from canopen_control.view.panels.html import Html, tell


def test_only_what_has_changed_is_sent():
    async def act(user, piece):
        outbox = user._client.outbox
        sent = []
        for text in ("a", "a", "b"):
            outbox.updates.clear()
            piece.show(text)
            sent.append(bool(outbox.updates))
        return sent

    assert visited(Html, act) == [True, False, True]


def test_a_notice_is_seen():
    async def act(user, _made):
        tell("Not driven", "another page drives")
        await user.should_see("Not driven: another page drives")

    visited(lambda: None, act)
