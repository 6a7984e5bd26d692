"""Choice of the PDOs for a drive: filled if possible, otherwise used unchanged."""

from support.drive_shapes import FOUR_PAIRS, TWO_MORE, TWO_PAIRS, shape, slots_of

from canopen_control.scaffold.pdo_choice import PdoRequirement, choose_pdos

WORD, MODE, SPEED, POSITION = (0x6040, 0), (0x6060, 0), (0x60FF, 0), (0x607A, 0)
COMMANDS = PdoRequirement(True, (WORD, SPEED), (MODE,), 255)
FEEDBACK = PdoRequirement(False, ((0x6041, 0),), ((0x6061, 0), (0x6064, 0), (0x606C, 0)))


def chosen(od, wish):
    uses, missing = choose_pdos(od, wish)
    return {use.number: use.objects for use in uses}, missing


def test_one_pdo_is_filled_up_to_64_bits_what_is_needed_first():
    assert chosen(shape(), COMMANDS) == ({1: (WORD, SPEED, MODE)}, ())
    assert chosen(shape(), FEEDBACK) == ({1: ((0x6041, 0), (0x6061, 0), (0x6064, 0)), 2: ((0x606C, 0),)}, ())


def test_of_fixed_mappings_the_one_with_everything_is_taken_and_no_second_controlword():
    assert chosen(shape(pdos=FOUR_PAIRS, access="const"), COMMANDS) == ({4: (WORD, SPEED)}, ())


def test_fixed_tpdos_may_repeat_the_statusword():
    uses, missing = chosen(shape(pdos=FOUR_PAIRS, access="const"), FEEDBACK)
    assert not missing
    assert {address for objects in uses.values() for address in objects} == {
        (0x6041, 0), (0x6061, 0), (0x6064, 0), (0x606C, 0)
    }  # fmt: skip


def test_with_granularity_0_the_devices_own_mapping_goes_first():
    uses, _ = choose_pdos(shape(device={"granularity": 0}), COMMANDS)
    assert [(use.number, use.remaps) for use in uses] == [(1, False), (2, False)]
    uses, _ = choose_pdos(shape(device={"granularity": 8}), COMMANDS)
    assert [(use.number, use.remaps) for use in uses] == [(1, True)]


def test_where_nothing_can_be_changed_all_that_is_live_is_used():
    uses, missing = choose_pdos(shape(pdos=TWO_PAIRS, access="const", cob_access="const"), COMMANDS)
    assert [(use.number, use.fixed, use.auto, use.transmission) for use in uses] == [
        (1, True, False, None),
        (2, True, False, None),
    ]
    assert missing == ()


def test_what_is_off_and_has_a_fixed_identifier_is_not_a_pdo_to_use():
    od = shape(access="const", cob_access="const", s1401_01={"default": 0x80000305, "access": "const"})
    assert chosen(od, COMMANDS)[1] == (SPEED,)


def test_what_is_not_there_or_not_mappable_is_missing():
    assert chosen(shape(drop=(0x60FF,)), COMMANDS)[1] == (SPEED,)
    assert chosen(shape(s60FF_00={"pdo_mappable": False}), COMMANDS)[1] == (SPEED,)
    assert chosen(shape(s60FF_00={"access": "ro"}), COMMANDS)[1] == (SPEED,)


def test_the_transmission_type_stays_where_the_device_takes_no_other():
    uses, _ = choose_pdos(shape(s1800_02={"low": 254, "high": 255}), FEEDBACK)
    assert [use.transmission for use in uses] == [None, 1]
    uses, _ = choose_pdos(shape(s1800_02={"access": "const"}), FEEDBACK)
    assert uses[0].transmission is None


def test_the_predefined_identifier_is_given_to_the_first_four_alone():
    more = [*TWO_PAIRS, *TWO_MORE, (True, 4, 0x0, [])]
    od = slots_of(shape(pdos=more), 1)
    for number in range(3):
        del od.entries[0x1400 + number, 1]
    uses, _ = choose_pdos(od, PdoRequirement(True, (WORD, SPEED)))
    assert [(use.number, use.auto) for use in uses] == [(4, True), (5, False)]
