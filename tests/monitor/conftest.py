import pytest

pytest.importorskip("textual", reason="textual is not installed: pip install canopen-control[monitor]")
