"""Whatever an EDS leaves out, fixes or forbids: a robot is refused in a sentence, or it passes the check."""

from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings
from hypothesis import strategies as st
from support.drive_shapes import FOUR_PAIRS, TWO_MORE, TWO_PAIRS, shape, slots_of, write_shape
from support.properties import examples

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.od.eds import read_eds
from canopen_control.runtime.robot_files import find_robot
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import write_robot

LEFT_OUT = (0x1001, 0x1014, 0x1016, 0x1017, 0x1018, 0x1029, 0x100C, 0x100D, 0x6007, 0x603F, 0x6042, 0x6060, 0x6061,
            0x6064, 0x606C, 0x607A, 0x6083, 0x6084, 0x608F, 0x60C2, 0x60FF, 0x6502)  # fmt: skip
MAPPED = (0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x607A, 0x60FF)


@st.composite
def drives(draw):
    drop = draw(st.sets(st.sampled_from(LEFT_OUT), max_size=5))
    unmappable = draw(st.sets(st.sampled_from(MAPPED), max_size=2)) - drop
    changes = {f"s{index:04X}_00": {"pdo_mappable": False} for index in unmappable}
    if 0x6502 not in drop:
        changes["s6502_00"] = {"default": draw(st.sampled_from([None, 0, 0x02, 0x08, 0x25, 0x81, 0xA5, 0x3EF]))}
    od = shape(
        drop=tuple(drop),
        pdos=draw(st.sampled_from([None, TWO_PAIRS, FOUR_PAIRS, [*TWO_PAIRS, *TWO_MORE]])),
        access=draw(st.sampled_from(["rw", "ro", "const"])),
        device={"granularity": draw(st.sampled_from([0, 1, 8]))},
        **changes,
    )
    return slots_of(od, draw(st.integers(1, 8)))


@given(drives())
@settings(max_examples=examples(15))
def test_every_drive_is_marked_by_name_or_passes_the_check(od):
    with TemporaryDirectory() as folder:
        path = write_shape(Path(folder), od)
        device = Device(5, path, read_eds(path, 5).od)
        robot = plan_robot("fresh", [device], allow_unsupervised=True)
        written = write_robot(robot, Path(folder))
        if not written.problems:
            assert check_robot(find_robot(str(written.folder)), CheckOptions()).passes()
        assert all(problem.startswith(f"{path}: ") for problem in robot.problems)
        assert bool(written.problems) == bool(robot.problems)
