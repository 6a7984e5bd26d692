"""The rows of the table of quirks."""

from canopen_control.virtual.quirks import QUIRKS

ALLOWED = ("mapping_count_first", "clock_drift")  # by the standard


def test_every_quirk_states_its_change_its_default_and_its_source():
    assert len(QUIRKS) >= 60
    for quirk in QUIRKS.values():
        assert quirk.does[0].islower()
        assert not quirk.does.endswith(".")
        assert quirk.clause.startswith(("CiA 301, ", "CiA 402-2, ")) or quirk.name in ALLOWED
        assert quirk.source
        assert (quirk.axis is None) != (quirk.node is None)
        if quirk.strength is not None:
            assert quirk.strength.low <= quirk.strength.default <= quirk.strength.high
            assert quirk.strength.unit
    assert sum(quirk.source != "unsourced" for quirk in QUIRKS.values()) >= 53
