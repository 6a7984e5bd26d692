from canopen_control.cia301.cob_id import EXTENDED_BIT, can_id_of
from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.frame import EXTENDED_FLAG


def test_the_identifier_of_an_entry_is_without_its_bits():
    assert can_id_of(INVALID_BIT | NO_RTR_BIT | 0x181) == 0x181


def test_an_identifier_of_29_bits_gets_the_flag_that_frames_have():
    assert can_id_of(INVALID_BIT | EXTENDED_BIT | 0x12345) == EXTENDED_FLAG | 0x12345
