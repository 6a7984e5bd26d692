"""From an EDS, as vendors write theirs, to a robot that passes `check --strict`, boots, is enabled and turns."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from support.drive_shapes import MAKERS, NODE, SHAPES, UNWATCHED, commissioned, shape, write_shape
from support.eds import DEVIATIONS
from support.iomodule import io_eds
from support.robots import Bench

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.cia402.state import State
from canopen_control.controllers.types import TYPES
from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.od.eds import read_eds
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.scaffold import bases
from canopen_control.scaffold.bases import BASES
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.drive_choice import GUESSED_COUNTS
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import controllers_text, write_robot


def planned(number, name="cell"):
    path = data_path("eds", f"generic_cia{number}.eds")
    return plan_robot(name, [Device(9, path, read_eds(path, 9).od)])


def controllers_of(number):
    return yaml.safe_load(controllers_text(planned(number)))


def test_outputs_are_commanded_by_name():
    file = controllers_of(401)
    assert file["controller_manager"]["ros__parameters"]["io_9_outputs"]["type"].endswith("/GpioCommandController")
    inputs = file["io_9_outputs"]["ros__parameters"]
    assert inputs["gpios"] == ["io_9"]
    assert inputs["command_interfaces"]["io_9"]["interfaces"][:2] == ["do0", "do1"]


def test_a_battery_is_reported_as_one():
    file = controllers_of(418)
    inputs = file["battery_9_broadcaster"]["ros__parameters"]
    assert inputs["batteries"] == ["battery_9"]
    assert inputs["interfaces"]["battery_9"] == {"battery_temperature": True, "battery_percentage": True}


def test_what_an_encoder_cannot_do_is_a_jump():
    node = yaml.safe_load(bus_text(planned(406)))["defaults"]
    assert node["signals"] == [{"name": "position", "max_rate": 30}]
    assert "signals" not in yaml.safe_load(bus_text(planned(410)))["defaults"]


def test_outputs_that_nothing_switches_off_need_a_word(tmp_path):
    path = tmp_path / "io.eds"
    path.write_text(io_eds())
    device = Device(5, path, read_eds(path, 5).od)
    written = write_robot(plan_robot("bare", [device]), tmp_path)
    assert any("keep their values when the master is lost" in warning for warning in written.warnings)
    word = write_robot(plan_robot("bare", [device], allow_unsupervised=True), tmp_path, force=True)
    assert not any("keep their values" in warning for warning in word.warnings)
    assert "NOTHING switches these outputs off" in (word.folder / "bus.yml").read_text()


@pytest.mark.parametrize("number", [401, 404, 406, 410, 418])
def test_a_device_alone_makes_a_robot_that_passes_the_strict_check(tmp_path, number):
    written = write_robot(planned(number), tmp_path)
    report = check_robot(find_robot(str(written.folder)), CheckOptions())
    assert report.passes(strict=True), report.findings


AO_OFF = {"$NODEID+0x300": "$NODEID+0x80000300"}
AO_UNMAPPED = {**AO_OFF, "0x64110110": "0", "0x64110210": "0", "0x64110310": "0", "0x64110410": "0"}
AO_ITEMS = [{"index": 0x6411, "sub_index": sub} for sub in range(1, 5)]
ON, AUTO = {"enabled": True}, {"enabled": True, "cob_id": "auto"}


@pytest.mark.parametrize(
    ("edits", "keys"),
    [
        ({}, {}),
        (AO_OFF, {"rpdo": {1: ON, 2: AUTO}}),
        (AO_UNMAPPED, {"rpdo": {1: ON, 2: {**AUTO, "mapping": AO_ITEMS}}}),
        ({"$NODEID+0x280": "$NODEID+0x80000280"}, {"tpdo": {1: ON, 2: AUTO}}),
    ],
)
def test_signals_whose_pdo_is_off_by_default_have_one(tmp_path, edits, keys):
    """PDOs 2 to 4 of a module may be off when it leaves the factory (CiA 401): the robot runs all the same."""
    text = data_path("eds", "generic_cia401.eds").read_text()
    for old, new in edits.items():
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "module.eds"
    path.write_text(text)
    written = write_robot(plan_robot("cell", [Device(9, path, read_eds(path, 9).od)]), tmp_path)
    node = yaml.safe_load((written.folder / "bus.yml").read_text())["defaults"]
    assert {key: node[key] for key in ("rpdo", "tpdo") if key in node} == keys
    report = check_robot(find_robot(str(written.folder)), CheckOptions())
    assert report.passes(), report.findings


def test_outputs_that_no_rpdo_can_carry_are_left_out(tmp_path):
    path = tmp_path / "module.eds"
    path.write_text(data_path("eds", "generic_cia401.eds").read_text())
    od = read_eds(path, 9).od
    od.entries[0x6411, 4] = replace(od[0x6411, 4], pdo_mappable=False)
    od.entries[0x1601, 0] = replace(od[0x1601, 0], default=3)
    robot = plan_robot("cell", [Device(9, path, od)])
    assert [signal.name for signal in robot.nodes[0].outputs if signal.name.startswith("ao")] == ["ao0", "ao1", "ao2"]
    assert "# No RPDO can carry the outputs 0x6411:04: write them by SDO." in bus_text(robot)


def keys_of(*ods, **how):
    devices = [Device(number, Path("d.eds"), od) for number, od in enumerate(ods, 2)]
    return yaml.safe_load(controllers_text(plan_robot("r", devices, **how)))


def test_a_base_goes_before_the_controllers_of_single_joints():
    keys = keys_of(shape(), shape(), base="diff")
    assert list(keys["controller_manager"]["ros__parameters"]) == [
        "update_rate",
        "joint_state_broadcaster",
        "base_controller",
        "velocity_controller",
    ]
    assert keys["base_controller"]["ros__parameters"]["position_feedback"] is True


def test_odometry_is_of_what_the_drives_report():
    blind = {"drop": (0x606C,), "s6064_00": {"pdo_mappable": False}}
    keys = keys_of(shape(**blind), shape(**blind), base="diff")
    assert keys["base_controller"]["ros__parameters"]["open_loop"] is True
    assert "joint_state_broadcaster" not in keys["controller_manager"]["ros__parameters"]


@pytest.fixture
def every_base(monkeypatch):
    """Let every controller of a base be there."""
    monkeypatch.setattr(bases, "TYPES", {base.type_name for base in bases.BASES.values()})


@pytest.mark.usefixtures("every_base")
def test_a_tricycle_names_its_wheels_from_right_to_left_and_its_steering():
    keys = keys_of(*[shape()] * 3, base="tricycle")
    parameters = keys["base_controller"]["ros__parameters"]
    assert parameters["traction_joints_names"] == ["right_wheel_joint", "left_wheel_joint"]
    assert parameters["steering_joints_names"] == ["steering_joint"]
    assert parameters["reference_timeout"] == 0.5
    assert keys["position_controller"]["ros__parameters"]["joints"] == ["steering_joint"]


@pytest.mark.usefixtures("every_base")
def test_a_mecanum_base_names_each_wheel_and_has_no_other_odometry():
    parameters = keys_of(*[shape()] * 4, base="mecanum")["base_controller"]["ros__parameters"]
    assert parameters["rear_left_wheel_command_joint_name"] == "rear_left_wheel_joint"
    assert parameters["kinematics.sum_of_robot_center_projection_on_X_Y_axis"] == 0.3
    assert not {"open_loop", "position_feedback", "cmd_vel_timeout"} & parameters.keys()


def new_robot(folder, *files, node_ids=(NODE,), name="fresh", force=False, **how):
    """Make a robot of EDS files, each for the node-ID at its place."""
    files = files * len(node_ids) if len(files) == 1 else files
    devices = [Device(node_id, path, read_eds(path, node_id).od) for path, node_id in zip(files, node_ids, strict=True)]
    return write_robot(plan_robot(name, devices, **how), folder, force=force)


def turned(folder, controller, node_id=NODE, *, seconds=1.0):
    """Boot a robot in simulated time and command 1 (rad/s or rad); return the joint and how far it turned by itself."""
    bench = Bench(f"scaffold_{folder.name}_{node_id}", config=str(folder), drives=(node_id,), controllers=[controller])
    try:
        bench.start()
        joint = bench.joint(node_id)
        plant = bench.drives[node_id].drives[0].mover.plant
        began = plant.position
        for _ in range(round(seconds * 10)):
            bench.robot.command(controller, [1.0] * len(bench.robot.joints), "test")
            bench.run(100)
        assert joint.state is State.OPERATION_ENABLED, bench.events[-3:]
        return joint.axis.scale.pos_to_dev, plant.position - began
    finally:
        bench.close()


@pytest.mark.rest
@pytest.mark.parametrize("what", [*SHAPES, *MAKERS])
def test_a_drive_as_vendors_describe_theirs_is_enabled_and_turns(tmp_path, what):
    make, interface, mode = (SHAPES | MAKERS)[what]
    written = new_robot(tmp_path, write_shape(tmp_path, make()))
    axis = written.robot.joints[0].axis
    assert (axis.interface, axis.mode.name) == (interface, mode)
    report = check_robot(find_robot(str(written.folder)), CheckOptions())
    assert report.passes(strict=what != "no feedback"), report.findings
    assert bool(written.warnings) is (what == "no feedback")
    counts, turn = turned(written.folder, f"{interface}_controller")
    assert math.copysign(1, turn) == 1
    if mode != "VL":  # revolutions per minute, whatever the scale
        assert 0.3 < turn / counts < 1.1


@pytest.mark.parametrize(("reported", "period"), [(10, 10_000), (1, 20_000), (15, 20_000), (None, 20_000)])
def test_the_sync_of_a_dcf_is_kept_where_a_computer_can_follow_it(tmp_path, reported, period):
    od = commissioned(shape(), {(0x60C2, 1): reported})
    written = new_robot(tmp_path, write_shape(tmp_path, od))
    assert written.robot.sync_us == period
    assert bool(written.warnings) is (reported in (1, 15))  # another time than SYNC's


def test_all_axes_of_one_drive_turn_and_may_be_the_wheels_of_a_base(tmp_path):
    path = write_shape(tmp_path, SHAPES["two axes"][0]())
    written = new_robot(tmp_path, path, base="diff")
    assert [joint.name for joint in written.robot.joints] == ["left_wheel_joint", "right_wheel_joint"]
    assert check_robot(find_robot(str(written.folder)), CheckOptions()).passes(strict=True)
    bench = Bench("scaffold_axes", config=str(written.folder), drives=(NODE,), controllers=["base_controller"])
    try:
        bench.start()
        for _ in range(10):
            bench.robot.command("base_controller", [0.2, 0.0], "test")
            bench.run(100)
        turned = [bench.drives[NODE].drives[axis].mover.plant.position for axis in range(2)]
        speeds = [joint.states["velocity"].value for joint in bench.robot.joints.values()]
    finally:
        bench.close()
    assert turned[0] < 0 < turned[1]  # the left motor is mounted mirrored
    assert speeds == [pytest.approx(4.0, rel=0.1)] * 2


@pytest.mark.parametrize("path", sorted(DEVIATIONS.glob("*.eds"))[:11], ids=lambda path: path.stem)
def test_an_eds_that_deviates_from_the_profile_boots_too(tmp_path, path):
    written = new_robot(tmp_path, path, allow_unsupervised=True)
    counts, turn = turned(written.folder, "velocity_controller")
    assert turn / counts > 0.3
    assert all("0x1017 is not in" in text for text in written.warnings)  # as is the case, and nothing else


def test_pdos_that_are_off_and_cannot_be_put_on_are_not_way_to_a_drive(tmp_path):
    path = next(DEVIATIONS.glob("12_*.eds"))
    written = new_robot(tmp_path, path, allow_unsupervised=True)
    (problem,) = written.problems
    assert problem.startswith(
        "12_pdos_fixed.eds: its modes are PP, PV, HM (0x6502), and no RPDO can carry the controlword"
    )
    text = (written.folder / "bus.yml").read_text()
    assert f"# PROBLEM, which prevents a run: {problem}" in text
    assert "# its PDOs are unchanged, and it moves no joint of the description" in text
    assert "bus.yml" in written.files


@pytest.mark.parametrize("what", UNWATCHED)
def test_a_drive_that_nothing_stops_needs_a_word(tmp_path, what):
    path = write_shape(tmp_path, UNWATCHED[what]())
    marked = new_robot(tmp_path, path, name="marked")
    assert any("nothing would stop this drive when the master is lost" in problem for problem in marked.problems)
    assert f"# PROBLEM, which prevents a run: {marked.problems[0]}" in (marked.folder / "bus.yml").read_text()
    assert not check_robot(find_robot(str(marked.folder)), CheckOptions()).passes()
    written = new_robot(tmp_path, path, allow_unsupervised=True)
    assert written.problems == ()
    assert "allow_unsupervised: true" in (written.folder / "bus.yml").read_text()


EDITS = Path(__file__).parents[1] / "data" / "eds_edits"


def findings(written, words):
    report = check_robot(find_robot(str(written.folder)), CheckOptions())
    return [finding for finding in report.findings if words in finding.text]


def test_counts_of_one_in_all_factors_are_a_guess_that_check_warns_of(tmp_path):
    written = new_robot(tmp_path, EDITS / "ones.eds")
    axis = written.robot.joints[0].axis
    assert (axis.is_known, axis.counts) == (False, GUESSED_COUNTS)
    text = (written.folder / "bus.yml").read_text()
    assert "A GUESS" in text
    assert "guesses: [counts_per_revolution]" in text
    (result,) = findings(written, "is a guess")
    assert result.severity is Severity.WARNING
    text = text.replace("guesses: [counts_per_revolution]", "").replace(
        "counts_per_revolution: 4096", "counts_per_revolution: 1"
    )
    (written.folder / "bus.yml").write_text(text)
    assert [finding.severity for finding in findings(written, "a whole turn is one count")] == [Severity.WARNING]


def test_a_feed_constant_of_one_means_the_same_to_the_robot_and_to_the_drive(tmp_path):
    written = new_robot(tmp_path, EDITS / "feedrpm.eds")
    axis = written.robot.joints[0].axis
    assert (axis.counts, axis.is_known, axis.rpm) == (2000, True, 1.0)
    counts, turn = turned(written.folder, "velocity_controller")
    assert 0.3 < turn / counts < 1.1


def test_a_drive_without_feedback_is_written_and_reported_and_simulated(tmp_path):
    written = new_robot(tmp_path, EDITS / "nofb.eds")
    (result,) = findings(written, "no TPDO carries 0x6064 or 0x606C")
    assert result.severity is Severity.WARNING
    assert "nofb.eds has neither" in result.fix
    assert any("no TPDO carries" in warning for warning in written.warnings)
    assert "# NO FEEDBACK: neither 0x6064" in (written.folder / "bus.yml").read_text()


BUILT = [name for name, base in BASES.items() if base.type_name in TYPES]


@pytest.mark.rest
@pytest.mark.parametrize("name", BUILT)
def test_a_base_passes_strictly_and_drives_forward(tmp_path, name):
    eds = data_path("eds", "generic_cia402.eds")
    ids = tuple(range(2, 2 + len(BASES[name].shapes[0])))
    written = new_robot(tmp_path, eds, node_ids=ids, base=name)
    assert written.warnings == ()
    bench = Bench(f"scaffold_{name}", config=str(written.folder), drives=ids)
    try:
        bench.start()
        values = [0.2, 0.0, 0.0] if name == "mecanum" else [0.2, 0.0]
        for _ in range(15):
            bench.robot.command("base_controller", values, "test")
            bench.run(100)
        speeds = {joint.joint: joint.states["velocity"].value for joint in bench.robot.joints.values()}
        plants = [bench.drives[node_id].drives[0].mover.plant.position for node_id in ids[:2]]
    finally:
        bench.close()
    wheels = [speed for joint, speed in speeds.items() if joint.endswith("wheel_joint")]
    assert wheels == pytest.approx([0.2 / 0.05] * len(wheels), rel=0.02)
    assert plants[0] < 0 < plants[1]  # the left motor is mounted mirrored


@pytest.mark.rest
@pytest.mark.parametrize("number", [401, 404, 406, 410, 418, 419])
def test_a_drive_and_a_device_next_to_it_pass_strictly(tmp_path, number):
    files = [data_path("eds", name) for name in ("generic_cia402.eds", f"generic_cia{number}.eds")]
    written = new_robot(tmp_path, *files, node_ids=(2, 4))
    assert check_robot(find_robot(str(written.folder)), CheckOptions()).passes(strict=True)


def test_two_files_of_one_name_get_two_names(tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    files = [write_shape(tmp_path, SHAPES["every mode"][0]()), write_shape(other, SHAPES["three slots"][0]())]
    written = new_robot(tmp_path, *files, node_ids=(4, 5))
    assert {"drive.eds", "drive_2.eds"} < set(written.files)
    text = (written.folder / "bus.yml").read_text()
    assert "dcf: drive.eds" in text
    assert "dcf: drive_2.eds" in text


def test_a_folder_that_is_there_stays_as_it_is_unless_that_is_asked_for(tmp_path):
    eds = data_path("eds", "generic_cia402.eds")
    folder = tmp_path / "fresh"
    folder.mkdir()
    (folder / "bus.yml").write_text("mine")
    with pytest.raises(RobotConfigError, match=r"exists already; choose another name, or .* --force"):
        new_robot(tmp_path, eds)
    assert (folder / "bus.yml").read_text() == "mine"
    (folder / "notes.txt").write_text("mine too")
    new_robot(tmp_path, eds, force=True)
    assert "sync_period" in (folder / "bus.yml").read_text()
    assert (folder / "notes.txt").read_text() == "mine too"


@pytest.mark.parametrize("kind", ["file", "link"])
def test_what_is_not_a_folder_is_never_written_over(tmp_path, kind):
    place = tmp_path / "fresh"
    if kind == "file":
        place.write_text("mine")
    else:
        place.symlink_to(tmp_path)
    with pytest.raises(RobotConfigError, match="exists and is not a folder"):
        new_robot(tmp_path, data_path("eds", "generic_cia402.eds"), force=True)


@pytest.mark.rest
def test_many_drives_on_a_slow_bus_get_a_sync_period_that_it_carries(tmp_path):
    od = SHAPES["every mode"][0]()
    object.__setattr__(od.device, "bit_rates", frozenset((50_000,)))
    written = new_robot(tmp_path, write_shape(tmp_path, od), node_ids=tuple(range(2, 8)))
    assert written.robot.baudrate == 50
    assert written.robot.sync_us > 20_000
    assert check_robot(find_robot(str(written.folder)), CheckOptions()).passes(strict=True)


@pytest.mark.parametrize(("rate", "written"), [(250, 250), (0, 1000), (333, 1000)])
def test_the_bit_rate_of_a_dcf_is_that_of_the_bus(tmp_path, rate, written):
    text = data_path("eds", "generic_cia402.eds").read_text()
    (tmp_path / "saved.dcf").write_text(f"{text}\n[DeviceComissioning]\nNodeID=2\nBaudrate={rate}\n")
    assert new_robot(tmp_path, tmp_path / "saved.dcf", node_ids=(2,)).robot.baudrate == written
