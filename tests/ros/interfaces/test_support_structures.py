from __future__ import annotations

import ctypes

import pytest

from canopen_control.ros.interfaces import support


@pytest.mark.parametrize(
    ("structure", "size"),
    [
        (support.Bytes, 24),
        (support.FieldTypeDescription, 48),
        (support.FieldDescription, 96),
        (support.IndividualDescription, 48),
        (support.TypeDescriptionStruct, 72),
        (support.Hash, 33),
        (support.FastCallbacks, 56),
        (support.MessageMember, 112),
        (support.Members, 64),
        (support.ServiceMembers, 40),
        (support.EventInfo, 40),
    ],
)
def test_structures_are_laid_out_as_the_headers_specify_on_a_64_bit_machine(structure, size):
    assert ctypes.sizeof(structure) == size


@pytest.mark.parametrize(
    ("structure", "size"), [(support.MessageSupport, 48), (support.ServiceSupport, 88), (support.ActionSupport, 64)]
)
def test_what_our_own_functions_return_stands_behind_the_header_of_a_support(structure, size):
    assert structure.hash.offset == size


def test_a_text_is_held_with_its_length_and_its_zero():
    held = support.string("grün")
    assert (held.size, held.capacity) == (5, 6)
    assert ctypes.string_at(held.data) == "grün".encode()


def test_a_sequence_is_its_items_and_an_empty_one_points_somewhere():
    sources = [support.TypeSource(support.string(name)) for name in ("a", "b")]
    held = support.sequence(support.TypeSource, sources)
    items = ctypes.cast(held.data, ctypes.POINTER(support.TypeSource))
    assert [ctypes.string_at(items[index].type_name.data) for index in range(held.size)] == [b"a", b"b"]
    empty = support.sequence(support.TypeSource, [])
    assert empty.size == 0
    assert empty.data
