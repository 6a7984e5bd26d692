from canopen_control.service.object_rows import bits_of, statusword_bits


def on(bits):
    return [each.name for each in bits if each.on]


def test_a_statusword_has_the_bits_of_its_mode():
    assert on(statusword_bits(0x0637)) == [
        *("ready to switch on", "switched on", "operation enabled", "voltage enabled", "no quick stop", "remote"),
        "target reached",
    ]
    assert "speed is zero" in on(statusword_bits(0x1637, 3))
    assert statusword_bits(0x1637, "PV") == statusword_bits(0x1637, 3)
    assert statusword_bits(0x1637, "mode -3 (manufacturer)") == statusword_bits(0x1637)
    assert "set-point acknowledged" in on(bits_of(0x6041, 0, 0x1637, 1))


def test_other_objects_have_theirs_and_most_have_none():
    assert on(bits_of(0x6840, 0, 0x010F))[-1] == "halt"
    assert on(bits_of(0x6040, 0, 0x001F, 1)) == [
        *("switch on", "enable voltage", "no quick stop", "enable operation"),
        "new set-point",
    ]
    assert on(bits_of(0x1001, 0, 0x05)) == ["generic", "voltage"]
    assert on(bits_of(0x6502, 0, 0x05)) == ["PP", "PV"]
    assert on(bits_of(0x60FD, 0, 0x06)) == ["positive limit switch", "home switch"]
    assert bits_of(0x6083, 0, 500) == []
    assert bits_of(0x1001, 0, "text") == []
    assert bits_of(0x6041, 1, 3) == []
