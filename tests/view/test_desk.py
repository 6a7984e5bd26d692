import inspect

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import Desk as Stub

from canopen_control.view.app import ViewApp
from canopen_control.view.desk import Desk


def test_the_view_and_the_tests_stand_in_have_what_panels_are_promised():
    for name in ("ask", "hold", "let_go", "look_at_faults"):
        promised = list(inspect.signature(getattr(Desk, name)).parameters)
        assert list(inspect.signature(getattr(ViewApp, name)).parameters) == promised
        assert list(inspect.signature(getattr(Stub, name)).parameters) == promised
