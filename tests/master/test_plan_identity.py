import pytest
from support.busfile import with_node


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
