"""BLF files with lengths that lie: each is read as far as it is true, and takes no more memory than it should."""

from __future__ import annotations

import re
import struct
import tracemalloc
import zlib

import pytest
from can.io import blf

from canopen_control.bus.pythoncan import LARGEST_CONTAINER
from canopen_control.bus.recordings import Recording, RecordingWriter
from canopen_control.frame import CanFrame

OBJECT = struct.Struct("<4sHHLL")
FIRST = 144  # where the first object begins


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "x.blf"
    with RecordingWriter(path, "can0") as writer:
        for number in range(50):
            writer.write(1_700_000_000_000_000_000 + number * 1_000_000, CanFrame(0x181, bytes([number])))
    return path


def read(path):
    """Return how many frames there are, what is said, and the most memory that it took, in bytes."""
    recording = Recording(path)
    tracemalloc.start()
    count = len(list(recording))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return count, recording.problem, peak


def container(data):
    packed = struct.pack("<H6xL4x", blf.ZLIB_DEFLATE, len(data)) + zlib.compress(data)
    return OBJECT.pack(b"LOBJ", 16, 1, OBJECT.size + len(packed), blf.LOG_CONTAINER) + packed


def test_it_reads_what_was_written(path):
    assert read(path)[:2] == (50, "")


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (4, 0xFFFFFFF0, "contains no frames|middle of a frame"),  # the header of the file claims four gigabytes
        (FIRST + 8, 0xFFFFFFF0, "the file ends in the middle of a frame"),  # an object does
        (FIRST + 8, 3, "an object has no valid signature or length"),  # an object is shorter than its header
        (FIRST, 0, "an object has no valid signature or length"),
    ],
)
def test_a_length_that_lies_is_a_sentence_and_no_memory(path, at, value, words):
    data = bytearray(path.read_bytes())
    data[at : at + 4] = value.to_bytes(4, "little")
    path.write_bytes(data)
    count, problem, peak = read(path)
    assert count == 0
    assert peak < 4 << 20
    assert re.search(words, problem), problem


@pytest.mark.rest
def test_a_container_that_unpacks_to_gigabytes_is_refused(path):
    path.write_bytes(path.read_bytes()[:FIRST] + container(bytes(LARGEST_CONTAINER + 1)))
    count, problem, peak = read(path)
    assert (count, problem.split(": ")[-1]) == (0, "a container unpacks to more than 64 MiB")
    assert peak < 3 * LARGEST_CONTAINER


def test_an_object_of_no_length_does_not_hold_the_reader_for_ever(path):
    endless = OBJECT.pack(b"LOBJ", 32, 1, 0, 1) + bytes(64)
    path.write_bytes(path.read_bytes()[:FIRST] + container(endless))
    count, problem, _ = read(path)
    assert (count, problem.split(": ")[-1]) == (0, "an object is shorter than its header")
