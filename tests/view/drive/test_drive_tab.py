from support.pages import FakeContext

from canopen_control.view.drive.drive_tab import DriveTabContext


def test_a_tab_has_its_node_and_the_state_from_the_robot():
    page = FakeContext()
    context = DriveTabContext(page, page.robot.node_jobs("left_drive"))
    assert (context.node, context.place.node_id) == ("left_drive", 3)
    assert context.reading(page.content()).nmt_state == "OPERATIONAL"
    assert context.reading(page.content(lost="gone")) is None
