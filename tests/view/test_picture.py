from support.pages import Desk, state


def test_the_banner_is_of_the_state_or_of_its_loss():
    desk = Desk()
    assert desk.picture().banner.words == "running"
    assert desk.picture(state(latched=True), lost="gone").banner.words == "not connected"


def test_what_is_commanded_comes_from_the_controllers():
    assert Desk().picture().commanded == {"left": "velocity"}
