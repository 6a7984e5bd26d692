import io
import os
import threading

from canopen_control.cli.run import Announcer


def test_lines_come_in_order_and_all_of_them_before_the_end():
    stream = io.StringIO()
    announcer = Announcer(stream)
    for number in range(100):
        announcer.put(f"line {number}")
    announcer.close()
    assert stream.getvalue().splitlines() == [f"line {number}" for number in range(100)]


def test_a_reader_that_stalls_blocks_no_other():
    class Stalled(io.StringIO):
        def write(self, text):
            released.wait(60)
            return len(text)

    released = threading.Event()
    announcer = Announcer(Stalled())
    for _ in range(1500):
        announcer.put("x")
    assert announcer.dropped > 0
    released.set()
    announcer.close()


def test_a_reader_that_is_gone_is_not_an_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        announcer = Announcer(stream)
        announcer.put("nobody hears this")
        announcer.close()
        assert announcer.dropped == 1
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
