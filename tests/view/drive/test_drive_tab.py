from support.pages import FakeContext

from canopen_control.view.drive.drive_tab import DriveTabContext


def test_a_tab_knows_its_node_and_what_the_robot_says_of_it():
    page = FakeContext()
    context = DriveTabContext(page, page.robot.node_jobs("left_drive"))
    assert (context.node, context.place.node_id) == ("left_drive", 3)
    assert context.reading(page.content()).nmt_state == "OPERATIONAL"
    assert context.reading(page.content(lost="gone")) is None
