from support.pages import FakeContext, state
from support.samples import event_of

from canopen_control.view.page_content import RecentEvents


def test_the_banner_is_of_the_state_or_of_its_loss():
    context = FakeContext()
    assert context.content().banner.words == "running"
    assert context.content(state(latched=True), lost="gone").banner.words == "not connected"


def test_what_is_commanded_comes_from_the_controllers():
    assert FakeContext().content().commanded == {"left": "velocity"}


def event(**changed):
    return event_of({"time": 1.0, "kind": "state", "level": "info", "text": "it happened"} | changed)


def test_what_happened_stands_there_as_it_was_reported():
    log = RecentEvents([event(time=1.0), event(time=2.0)])
    assert [(item.count, item.first, item.time) for item in log] == [(1, 1.0, 1.0), (1, 2.0, 2.0)]


def test_what_the_runtime_has_counted_takes_the_place_of_its_beginning():
    log = RecentEvents([event(time=5.0), event(text="between"), event(since=5.0, count=40, time=8.0)])
    assert [(item.text, item.count) for item in log] == [("between", 1), ("it happened", 40)]
