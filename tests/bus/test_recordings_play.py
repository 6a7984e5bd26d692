from canopen_control.bus.error_frames import bus_off_frame
from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.recordings import PlayReport, RecordedFrame, play
from canopen_control.frame import CanFrame

MS = 1_000_000


class Clock:
    """Time that passes only while somebody sleeps; each sleep ends `late` ns after what was asked for."""

    def __init__(self, late=0):
        self.now, self.late, self.naps = 1_000 * MS, late, []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.naps.append(round(seconds * 1e9))
        self.now += self.naps[-1] + self.late


def played(times_ms, name, late=0, speed=1.0, frames=None):
    bus, clock = MemoryBus.get(name), Clock(late)
    port, ear = bus.open("replay"), bus.open("ear")
    frames = frames or [CanFrame(0x100 + number) for number in range(len(times_ms))]
    begin, sent_at = clock.now, []

    class Noting:
        """The port, and when each frame was given to it."""

        stats, wants_write, receive = port.stats, False, staticmethod(port.receive)

        @staticmethod
        def send(records):
            sent_at.append((clock.now - begin) / MS)
            port.send(records)

    recorded = [RecordedFrame(5_000 * MS + round(ms * MS), frame) for ms, frame in zip(times_ms, frames, strict=True)]
    result = PlayReport()
    play(recorded, Noting(), result, speed=speed, clock=clock, sleep=clock.sleep)
    received = len(ear.receive()) // 16
    port.close()
    ear.close()
    return result, sent_at, received


def test_frames_are_sent_with_the_spacing_they_were_received_with():
    result, sent_at, received = played([0, 20, 20, 45], "play")
    assert sent_at == [0, 20, 20, 45]
    assert (result.frames, received, result.late_max) == (4, 4, 0.0)


def test_a_late_frame_does_not_delay_the_next_and_is_reported():
    result, sent_at, _ = played([0, 20, 40], "play-late", late=3 * MS)
    assert sent_at == [0, 23, 43]
    assert result.late_max == 0.003


def test_error_frames_are_never_sent_and_a_clock_that_goes_back_waits_for_nothing():
    frames = [CanFrame(0x100), bus_off_frame(), CanFrame(0x101), CanFrame(0x102)]
    result, sent_at, received = played([0, 10, 20, -500], "play-odd", frames=frames)
    assert (result.frames, result.errors, received) == (3, 1, 3)
    assert sent_at == [0, 20, 20]
    assert result.late_max == 0.0
