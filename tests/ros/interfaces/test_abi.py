from __future__ import annotations

import ctypes

import pytest

from canopen_control.ros.interfaces import abi


@pytest.mark.parametrize(
    ("structure", "size"),
    [
        (abi.Bytes, 24),
        (abi.FieldTypeDescription, 48),
        (abi.FieldDescription, 96),
        (abi.IndividualDescription, 48),
        (abi.TypeDescriptionStruct, 72),
        (abi.Hash, 33),
        (abi.FastCallbacks, 56),
        (abi.MessageMember, 112),
        (abi.Members, 64),
        (abi.ServiceMembers, 40),
        (abi.EventInfo, 40),
    ],
)
def test_structures_are_laid_out_as_the_headers_specify_on_a_64_bit_machine(structure, size):
    assert ctypes.sizeof(structure) == size


@pytest.mark.parametrize(
    ("structure", "size"), [(abi.MessageSupport, 48), (abi.ServiceSupport, 88), (abi.ActionSupport, 64)]
)
def test_what_our_own_functions_return_stands_behind_the_header_of_a_support(structure, size):
    assert structure.hash.offset == size


def test_a_text_is_held_with_its_length_and_its_zero():
    held = abi.string("grün")
    assert (held.size, held.capacity) == (5, 6)
    assert ctypes.string_at(held.data) == "grün".encode()


def test_a_sequence_is_its_items_and_an_empty_one_points_somewhere():
    held = abi.sequence(abi.TypeSource, [abi.TypeSource(abi.string("a")), abi.TypeSource(abi.string("b"))])
    items = ctypes.cast(held.data, ctypes.POINTER(abi.TypeSource))
    assert [ctypes.string_at(items[index].type_name.data) for index in range(held.size)] == [b"a", b"b"]
    empty = abi.sequence(abi.TypeSource, [])
    assert empty.size == 0
    assert empty.data
