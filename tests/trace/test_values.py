import pytest
from support.tracing import robby_network

from canopen_control.cia402.state import State
from canopen_control.od.model import DataType
from canopen_control.trace.network_description import NodeDescription
from canopen_control.trace.values import NodeWords, controlword_text, decoded, is_faulty, statusword_text


@pytest.mark.parametrize(
    ("word", "mode", "text"),
    [
        (0x0237, None, "0x0237 OPERATION ENABLED"),
        (0x0637, None, "0x0637 OPERATION ENABLED, target reached"),
        (0x1637, 9, "0x1637 OPERATION ENABLED, follows the set-point"),  # bit 10 is reserved in CSV
        (0x2237, 8, "0x2237 OPERATION ENABLED, following error"),
        (0x0227, None, "0x0227 OPERATION ENABLED, no voltage"),
        (0x0AB1, None, "0x0AB1 READY TO SWITCH ON, warning, internal limit"),
        (0x0008, None, "0x0008 FAULT, not remote"),
        (0x0650, None, "0x0650 SWITCH ON DISABLED"),  # nothing is reached without torque
        (0x0203, None, "0x0203 undefined state"),
    ],
)
def test_a_statusword_is_a_state_and_what_is_odd_about_it(word, mode, text):
    assert statusword_text(word, mode) == text


def test_a_controlword_is_a_command():
    assert controlword_text(0x0006) == "0x0006 SHUTDOWN"
    assert controlword_text(0x0007) == "0x0007 SWITCH ON"
    assert controlword_text(0x0007, state=State.OPERATION_ENABLED) == "0x0007 DISABLE OPERATION"
    assert controlword_text(0x010F) == "0x010F ENABLE OPERATION, halt"
    assert controlword_text(0x001F, mode=1) == "0x001F ENABLE OPERATION, new set-point"
    assert controlword_text(0x0080, 0x0080) == "0x0080 FAULT RESET held"


def test_faults_are_faulty_and_the_rest_is_not():
    assert [state for state in State if is_faulty(state)] == [State.FAULT_REACTION_ACTIVE, State.FAULT]
    assert not is_faulty(None)


@pytest.mark.parametrize(
    ("index", "subindex", "value", "text"),
    [
        (0x1000, 0, 0x00040192, "0x00040192 (profile 402)"),
        (0x1001, 0, 0x21, "0x21 (generic, device profile)"),
        (0x1003, 1, 0x00018611, "0x00018611 (following error)"),
        (0x1018, 1, 0x286, "0x00000286"),
        (0x1400, 1, 0x203, "0x00000203 (0x203, on)"),
        (0x1800, 2, 5, "5 (every 5 SYNCs)"),
        (0x1800, 3, 15, "15 (1.5 ms)"),
        (0x1800, 5, 0, "0"),
        (0x1600, 0, 2, "2"),
        (0x1600, 1, 0x00050008, "0x00050008 (0x0005:00 dummy UNSIGNED8, 8 bits)"),
        (0x1600, 1, 0, "0 (nothing)"),
        (0x1016, 1, 0, "0x00000000 (no node)"),
        (0x1029, 1, 2, "2 (to STOPPED)"),
        (0x1029, 1, 9, "9"),
        (0x6502, 0, 0xA5, "0x000000A5 (PP, PV, HM, CSP)"),
        (0x603F, 0, 0x8611, "0x8611 (following error)"),
        (0x6061, 0, -3, "-3"),
        (0x6061, 0, 9, "9 CSV"),
        (0x6064, 0, -5, "-5"),
        (0x1008, 0, "TMCM", "'TMCM'"),
        (0x2000, 0, 0.25, "0.25"),
        (0x2000, 0, b"\x01\x02", "01 02"),
    ],
)
def test_values_are_reported_in_the_words_of_their_object(index, subindex, value, text):
    assert NodeWords(robby_network().nodes[3]).text(index, subindex, value) == text


def test_a_device_that_is_not_a_drive_has_plain_numbers_there():
    from canopen_control.od.model import Entry, ObjectDictionary

    od = ObjectDictionary()
    od.add(Entry(0x1000, 0, "type", DataType.UNSIGNED32, default=0x191))
    words = NodeWords(NodeDescription("io", 4, od))
    assert words.text(0x6041, 0, 0x37) == "55"
    assert words.name(0x6041, 0) == ""


def test_the_second_axis_has_its_own_history():
    words = NodeWords(NodeDescription("two", 4))
    words.text(0x6061, 0, 9)
    words.text(0x6861, 0, 8)
    assert words.text(0x6041, 0, 0x2237) == "0x2237 OPERATION ENABLED"
    assert words.text(0x6841, 0, 0x2237) == "0x2237 OPERATION ENABLED, following error"
    assert words.name(0x6841, 0) == "statusword (axis 1)"


def test_bytes_that_do_not_fit_their_type_stay_bytes():
    assert decoded(b"\x01\x02", DataType.UNSIGNED32) == b"\x01\x02"
    assert decoded(b"\x01\x02", None) == 0x0201
    assert decoded(b"\x01\x02\x03", None) == b"\x01\x02\x03"
