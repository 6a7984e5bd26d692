import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import Desk, html, state, visited

from canopen_control.view.panels.joints import JointsPanel


def test_the_joints_are_told_in_their_units_and_stay_when_the_robot_is_lost():
    desk = Desk()

    async def act(user, panel):
        panel.show(desk.picture())
        before = html(user)
        panel.show(desk.picture(state(joints={}), lost="it has died"))
        return before, html(user)

    before, after = visited(lambda: JointsPanel(desk), act)
    assert "2.50<small>velocity" in before
    assert "0.10<small>m<" in before
    assert before == after
