import pytest
from support.busfile import NESTED, with_node, write

from canopen_control.data_files import data_path
from canopen_control.master.config import read_bus


@pytest.mark.parametrize(
    ("keys", "vendor", "product", "warned"),
    [
        ("", 0x286, 0x4F6, ()),
        ("vendor_id: 0x286, product_code: 0x4F6", 0x286, 0x4F6, ()),
        ("vendor_id: 0, product_code: 0", 0, 0, ()),
        ("vendor_id: 0x287", 0x287, 0x4F6, ("vendor_id",)),
        ("product_code: 1", 0x286, 1, ("product_code",)),
    ],
)
def test_vendor_and_product_are_those_of_bus_yml_before_the_edss(tmp_path, keys, vendor, product, warned):
    bus = with_node(tmp_path, keys)
    identity = bus.plans["right_drive"].identity
    assert (identity.vendor_id, identity.product_code) == (vendor, product)
    reported = [note for note in bus.notes if "is required, but" in note]
    assert len(reported) == len(warned)
    assert all(key in text for key, text in zip(warned, reported, strict=True))


def test_an_object_of_the_identity_that_the_eds_lacks_is_reported(tmp_path):
    (note,) = [
        note for note in with_node(tmp_path, "serial_number: 5, software_version: 3").notes if "compared" in note
    ]
    assert (
        "software_version: is compared with 0x1F56:01, which is not in TMCM-1270.eds; remove software_version" in note
    )


@pytest.mark.parametrize(
    ("name", "section", "baudrate", "warned"),
    [
        ("saved.dcf", "Baudrate=250", 500, "saved.dcf was saved at 250 kbit/s, and the bus has 500; set the device to"),
        ("saved.dcf", "Baudrate=500", 500, ""),
        ("saved.dcf", "Baudrate=0", 500, ""),
        ("saved.eds", "Baudrate=250", 500, ""),
        ("saved.dcf", "Baudrate=250", 1000, "lists 20, 50, 125, 250, 500, 800 kbit/s for this device, and the bus has"),
    ],
)
def test_a_bit_rate_that_the_device_does_not_have_is_reported(tmp_path, name, section, baudrate, warned):
    text = data_path("eds", "TMCM-1270.eds").read_text()
    if baudrate == 1000:
        assert "BaudRate_1000=1" in text
        text = text.replace("BaudRate_1000=1", "BaudRate_1000=0")
    (tmp_path / name).write_text(f"{text}\n[DeviceComissioning]\nNodeID=2\n{section}\n")
    bus = NESTED.replace("TMCM-1270.eds", name).replace("node_id: 1\n", f"node_id: 1\n      baudrate: {baudrate}\n")
    assert f"baudrate: {baudrate}" in bus
    notes = [note for note in read_bus(write(tmp_path, bus)).notes if "kbit/s" in note]
    assert len(notes) == bool(warned)
    assert warned in "".join(notes)
