import importlib.util

import pytest

from canopen_control.errors import ConfigError
from canopen_control.view.available import require_view


def test_without_nicegui_it_says_what_to_type(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[view\]'"):
        require_view()


def test_with_nicegui_it_says_nothing():
    pytest.importorskip("nicegui")
    require_view()
