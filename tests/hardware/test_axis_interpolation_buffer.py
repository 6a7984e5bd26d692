"""The buffer of set-points of mode IP (0x60C4) contains none from before an enable."""

import pytest
from support.makers import COUNTS, drive, sentences

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402.state import State
from canopen_control.virtual.trajectory import hold

ENTRIES = ((1, 7, 32, "ro"), (2, 7, 0, "rw"), (3, 5, 0, "rw"), (4, 6, 0, "rw"), (5, 5, 4, "wo"))


def section(subindex, data_type, default, access):
    return (
        f"[60C4sub{subindex}]\nParameterName=buffer {subindex}\nObjectType=0x7\nDataType={data_type}\n"
        f"AccessType={access}\nDefaultValue={default}\nPDOMapping=0\n\n"
    )


def with_buffer(access, initial):
    """Return an edit of the EDS that adds the buffer, whose 0x60C4:06 has an access and an initial value."""

    def edit(text):
        assert "SupportedObjects=126\n1=0x1003\n" in text
        text = text.replace("SupportedObjects=126\n1=0x1003\n", "SupportedObjects=127\n127=0x60C4\n1=0x1003\n")
        entries = [(0, 5, 6, "ro"), *ENTRIES, (6, 5, initial, access)]
        head = "\n[60C4]\nParameterName=Interpolation data configuration\nObjectType=0x9\nSubNumber=7\n\n"
        return text + head + "".join(section(*entry) for entry in entries)

    return edit


def buffer_of(created, node_id=2):
    return drive(created, node_id).modes.interpolated.buffer


def lead(created, cycles):
    goal = [created.position(joint) for joint in ("pan", "tilt")]
    for _ in range(cycles):
        goal = [position + 0.01 for position in goal]
        created.command("pos", *goal)
        created.run(0.02)


def push(created, way):
    """Move the shaft of a disabled drive."""
    mover = drive(created, 2).mover
    mover.plant.position += way * COUNTS
    mover.demand = hold(mover.time, mover.plant.position)


def test_set_points_from_before_a_stop_do_not_move_the_axis_at_the_next_enable(robot):
    created = robot("ip", edit=with_buffer("rw", 1))
    for item in created.drives:
        item.quirk("records_kept")
    lead(created, 40)
    assert created.position("pan") == pytest.approx(0.4, abs=0.05)
    created.disable()
    created.run(1.5)
    assert len(buffer_of(created)) == 0
    push(created, 0.2)
    created.run(0.5)
    plant = drive(created, 2).mover.plant
    before = plant.position
    created.enable()
    for _ in range(150):
        created.run(0.01)
        assert abs(plant.position - before) < 10
    assert created.state == "running"
    lead(created, 40)
    created.run(0.5)
    assert created.position("pan") == pytest.approx(before / COUNTS + 0.4, abs=0.01)
    assert created.breaches == []


def test_a_buffer_that_is_closed_is_not_written(robot):
    created = robot("ip", edit=with_buffer("rw", 0))
    lead(created, 10)
    created.disable()
    created.run(1.0)
    created.enable()
    created.run(1.0)
    assert not [frame for _, _, frame in created.bus.frames if frame.data[:4] == bytes.fromhex("2fc46006")]
    assert created.state == "running"


def test_a_buffer_that_cannot_be_opened_ends_the_enable(robot):
    created = robot("ip", edit=with_buffer("rw", 1))
    created.disable()
    created.run(1.0)

    def refuse(_entry, _value):
        raise SdoServerAbort(AbortCode.DEVICE_STATE)

    created.simulated.drives[2].device.store.guard([0x60C4], refuse)
    created.enable()
    created.run(2.0)
    assert any(
        "pan_drive" in sentence and "its buffer of set-points (0x60C4:06) could not be" in sentence
        for sentence in sentences(created)
    )
    assert created.state == "disabled"
    assert drive(created, 2).state is State.SWITCH_ON_DISABLED
