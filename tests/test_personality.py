"""Personalities: the bundled files, errors in a file, and the choice by identity."""

import dataclasses
import typing

import pytest

from canopen_control.errors import ConfigError
from canopen_control.master.keys import NodeConfig
from canopen_control.personality import PersonalityError, personality_names, personality_of, read_personality
from canopen_control.virtual.quirks import quirks_of

NAMES = """copley delta elmo epos4 faulhaber festo ingenia ipos kinco leadshine nanotec schneider tmcm1270 vfd
    zlac""".split()  # noqa: SIM905 - one name a line is not a list


def test_every_bundled_personality_has_sources_and_what_is_not_known():
    assert personality_names() == NAMES
    for name in NAMES:
        personality = read_personality(name)
        assert personality.name == name
        assert personality.quirks
        assert personality.not_known
        assert quirks_of(personality)
        assert all(line.source for line in personality.quirks)


def known_keys(cls):
    """Yield the keys of a node in bus.yml, with those of its parts."""
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        yield field.metadata.get("key") or field.name
        if dataclasses.is_dataclass(hints[field.name]):
            yield from known_keys(hints[field.name])


def test_the_keys_of_bus_yml_are_keys_of_bus_yml():
    keys = set(known_keys(NodeConfig))
    for name in NAMES:
        assert {key.key for key in read_personality(name).bus_keys} <= keys


def test_a_key_is_written_as_bus_yml_has_it():
    assert [key.text for key in read_personality("festo").bus_keys] == [
        "mode_timeout_ms: 8000",
        "transition_timeouts_ms: {3: 10000}",
    ]
    assert [key.text for key in read_personality("delta").bus_keys] == [
        "sdo: [{index: 0x1006, sub_index: 0, value: 10000}]"
    ]


@pytest.mark.parametrize(
    ("vendor", "product", "name"),
    [
        (0x9A, 0x30924, "elmo"),
        (0xFB, 0x61500000, "epos4"),
        (0x286, 0x4F6, "tmcm1270"),
        (0x286, 0x1, None),
        (0x681168, 0x464445, "kinco"),
        (0x123456, 0x1, None),
        (None, None, None),
    ],
)
def test_which_personality_fits_an_identity(vendor, product, name):
    result = personality_of(vendor, product)
    assert (result and result.name) == name


def test_a_name_that_is_none_lists_the_available_ones():
    with pytest.raises(
        PersonalityError, match=r"^no personality 'elm' \(did you mean 'elmo'\?\); available: copley, delta"
    ):
        read_personality("elm")


def test_a_file_that_is_not_there_reports_which_names_there_are():
    with pytest.raises(PersonalityError, match=r"^no file './ours.yaml'; available: copley, delta[^;]*; or a file"):
        read_personality("./ours.yaml")


def test_a_file_of_a_user(tmp_path):
    path = tmp_path / "ours.yaml"
    path.write_text(
        "title: Our drive\nquirks:\n  - {quirk: brake_delay=0.8, source: measured}\n  - {quirk: remote_never}\n"
    )
    personality = read_personality(str(path))
    assert (personality.name, personality.identity, personality.quirks[1].source) == ("ours", [], "unsourced")
    assert quirks_of(personality) == ["brake_delay=0.8", "remote_never"]
    assert personality.place(personality.quirks[1]) == f"{path}:4"


def test_every_error_of_a_file_is_reported_with_its_line(tmp_path):
    path = tmp_path / "ours.yaml"
    path.write_text("title: Our drive\nqirks: []\nmodes: [0]\nquirks:\n  - {qurk: remote_never}\n")
    with pytest.raises(PersonalityError) as error:
        read_personality(str(path))
    for line in (2, 3, 5):
        assert f"{path}:{line}:" in str(error.value)
    path.write_text("title: Our drive\nquirks:\n  - {quirk: remote_never, source: ' '}\n")
    with pytest.raises(PersonalityError, match=r"ours\.yaml:3:5: .* source: empty"):
        read_personality(str(path))


def test_quirks_of_a_file_that_cannot_be_are_reported_with_their_lines(tmp_path):
    path = tmp_path / "ours.yaml"
    lines = ["brake_dely", "brake_delay=99", "remote_never", "remote_when_enabled", "remote_never"]
    path.write_text("title: Our drive\nquirks:\n" + "".join(f"  - {{quirk: {line}}}\n" for line in lines))
    with pytest.raises(ConfigError) as error:
        quirks_of(read_personality(str(path)))
    reported = str(error.value).splitlines()
    assert [line.split(":")[1] for line in reported] == ["3", "4", "6", "7"]
    assert "did you mean 'brake_delay'" in reported[0]
    assert "the strength must be" in reported[1]
    assert "exclude each other" in reported[2]
    assert "is given twice" in reported[3]
