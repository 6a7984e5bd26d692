from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.service.parameter_set import DeviceIdentity, ParameterSet, differences, parameter_text

OD = read_eds(data_path("eds", "TMCM-1270.eds")).od


def side(node_id, **values):
    found = {(int(name[1:5], 16), int(name[6:8], 16)): value for name, value in values.items()}
    return ParameterSet(OD.for_node(node_id), node_id, DeviceIdentity(), found, f"node {node_id}")


def test_equal_sides_have_no_difference():
    assert differences(side(5, s6081_00=3), side(5, s6081_00=3)) == []


def test_what_follows_the_node_id_is_compared_without_it():
    a = side(5, s1800_01=0x40000185)
    assert differences(a, side(6, s1800_01=0x40000186)) == []
    (found,) = differences(a, side(6, s1800_01=0x40000185))
    assert (found.a_text, found.b_text) == ("$NODEID+0x40000180", "0x40000185")


def test_a_difference_has_name_and_both_values():
    (found,) = differences(side(5, s6081_00=3), side(5, s6081_00=4))
    assert (found.entry.address, found.name, found.a, found.b) == ((0x6081, 0), "Profile velocity", 3, 4)
    assert (found.a_text, found.b_text) == ("3", "4")


def test_what_one_side_lacks_differs_unless_it_is_skipped():
    (found,) = differences(side(5, s6081_00=3), side(5))
    assert (found.a, found.b, found.b_text) == (3, None, "")
    assert differences(side(5, s6081_00=3), side(5), {(0x6081, 0)}) == []


def test_mappings_are_shown_as_a_dcf_writes_them():
    assert parameter_text(side(5, s1600_01=0x60400010), (0x1600, 1)) == "0x60400010"
