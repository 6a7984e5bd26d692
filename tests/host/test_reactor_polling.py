import selectors

from canopen_control.host.reactor import MarkedSelector, Reactor, open_poller
from canopen_control.host.timer import ManualClock


def test_a_marked_descriptor_is_readable_until_it_is_unmarked():
    selector = MarkedSelector()
    first, second = selector.allocate(), selector.allocate()
    selector.register(first, selectors.EVENT_READ, "a")
    selector.register(second, selectors.EVENT_READ, "b")
    selector.set_ready(second)
    selector.set_ready(first)
    assert [key.data for key, _ in selector.select()] == ["b", "a"]
    selector.clear_ready(second)
    selector.clear_ready(second)
    assert [key.data for key, _ in selector.select()] == ["a"]


def test_a_descriptor_not_watched_for_reading_is_not_reported():
    selector = MarkedSelector()
    number = selector.allocate()
    selector.set_ready(number)
    assert selector.select() == []
    selector.register(number, selectors.EVENT_WRITE)
    assert selector.select() == []
    selector.modify(number, selectors.EVENT_READ)
    assert len(selector.select()) == 1
    selector.close()
    assert selector.select() == []
    assert not selector.get_map()


def test_a_reactor_on_marks_serves_what_is_marked():
    selector = MarkedSelector()
    number = selector.allocate()
    observed = []
    with Reactor(ManualClock(7), selector) as reactor:

        def read():
            observed.append(reactor.now())
            selector.clear_ready(number)

        reactor.add_reader(number, read)
        reactor.serve()
        assert observed == []
        selector.set_ready(number)
        reactor.serve()
        assert observed == [7]


def test_marks_and_epoll_are_asked_themselves_other_selectors_are_not():
    marked = MarkedSelector()
    assert open_poller(marked) is marked
    with selectors.SelectSelector() as selector:
        assert open_poller(selector) is None
    with selectors.DefaultSelector() as selector:
        epoll = open_poller(selector)
        if epoll is not None:
            epoll.close()
            assert isinstance(selector, selectors.EpollSelector)
