"""Robby's network description and a decoder of it, for tests of what listens."""

import functools

from canopen_control.data_files import data_path
from canopen_control.frame import CanFrame
from canopen_control.master.config import read_bus
from canopen_control.master.pdo_layout import layout_of
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import network_of_layout


@functools.cache
def robby_network():
    return network_of_layout(layout_of(read_bus(data_path("config", "robby") / "bus.yml"), "local:robby"))


def robby_decoder():
    return Decoder(robby_network())


def frame(can_id, data=""):
    return CanFrame(can_id, bytes.fromhex(data))


def said(decoder, *frames):
    """Decode (can_id, hex) pairs and return the texts."""
    return [decoder.decode(frame(*fields)).text for fields in frames]


def check_transcript(text, decoder=None):
    """Decode the frames at the beginning of lines, and compare what is reported of each with the rest of its line."""
    decoder, lines = decoder or robby_decoder(), [line.strip() for line in text.strip().splitlines()]
    frames = [line.partition(" ")[0] for line in lines]
    texts = said(decoder, *((int(can_id, 16), data) for can_id, _, data in (item.partition("#") for item in frames)))
    assert [f"{each} {reported}" for each, reported in zip(frames, texts, strict=True)] == lines
