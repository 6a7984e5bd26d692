import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import visited

from canopen_control.view.elements.strip_charts import StripCharts
from canopen_control.view.sampling import charts, names


def test_every_line_is_a_row_that_is_sent():
    async def act(_user, strips):
        return strips.props["charts"], strips.props["names"]

    found, rows = visited(lambda: StripCharts(charts(["a"], ["can"]), names(["a"], ["can"]), 30.0), act)
    assert {line["row"] for chart in found for line in chart["lines"]} <= set(rows)
