import inspect

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")
from support.pages import FakeContext, visited

from canopen_control.view.panels.panel import Html, PanelContext, tell
from canopen_control.view.view_app import ViewApp


def test_the_view_and_the_tests_stand_in_have_what_panels_are_promised():
    for name in ("ask", "hold", "let_go", "refresh_faults"):
        promised = list(inspect.signature(getattr(PanelContext, name)).parameters)
        assert list(inspect.signature(getattr(ViewApp, name)).parameters) == promised
        assert list(inspect.signature(getattr(FakeContext, name)).parameters) == promised


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
