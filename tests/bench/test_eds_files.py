"""Made-up EDS files: the same everywhere, as large as they say, and good EDS files to both readers."""

import pytest
from canopen_control_bench.eds_files import DUMMIES, SHAPES, written
from canopen_control_bench.peers.sdo_canopen import import_eds

from canopen_control.interop.canopen import to_canopen
from canopen_control.od.eds import Severity, parse_eds

SMALL = [shape for shape in SHAPES if shape.entries <= 3000]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_a_shape_has_its_entries_and_nothing_that_is_odd(shape):
    file = parse_eds(written(shape), 5)
    assert shape.entries <= len(file.od) < shape.entries + 260  # the last object is a whole one
    assert [str(issue) for issue in file.issues if issue.severity is not Severity.NOTE] == []


def test_a_shape_is_the_same_file_each_time():
    assert written(SHAPES[0]) == written(SHAPES[0]) != written(SHAPES[1])


@pytest.mark.parametrize("shape", SMALL, ids=lambda shape: shape.name)
def test_both_readers_find_the_same_values(shape, tmp_path):
    path = tmp_path / "large.eds"
    path.write_bytes(written(shape))
    theirs, ours = import_eds(str(path), 5), to_canopen(parse_eds(path.read_bytes(), 5).od)
    assert len(ours) == len(theirs) - DUMMIES
    for index, thing in ours.items():
        if hasattr(thing, "data_type"):
            assert (thing.name, thing.data_type) == (theirs[index].name, theirs[index].data_type)
