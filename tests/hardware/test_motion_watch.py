"""Reactions of the master to drives that deviate from the standard, one deviation per test."""

import itertools
import math
import re
from types import SimpleNamespace

import pytest
from support.makers import COUNTS, drive, folder, sentences

from canopen_control.cia402.state import State
from canopen_control.cia402.units import PositionUnwrapper, Scale
from canopen_control.errors import BusConfigError
from canopen_control.frame import CanFrame
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.axis_statechart import STOPPED, AxisPhase
from canopen_control.hardware.mode_targets import VelocityTarget
from canopen_control.hardware.motion_watch import MotionWatch
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot
from canopen_control.virtual.fault_table import FaultSwitches
from canopen_control.virtual.plant import LoadedPlant
from canopen_control.virtual.profile_modes import ProfilePosition
from canopen_control.virtual.virtual_drive import Statusword, VirtualDrive

MS = 1_000_000


@pytest.fixture
def standing(monkeypatch):
    """Drives that are enabled and take no set-points; the dictionary's `ms` bounds how long, None for ever."""
    refresh, since, limit = VirtualDrive.refresh, {}, {"ms": None}

    def stand(self, now, *, controlword=False, set_point=False):
        if self.power.state is not State.OPERATION_ENABLED:
            since.pop(id(self), None)
        elif limit["ms"] is None or now - since.setdefault(id(self), now) < limit["ms"] * MS:
            self.mover.advance(now)
            if controlword:
                self._control(now)
            return
        refresh(self, now, controlword=controlword, set_point=set_point)

    monkeypatch.setattr(VirtualDrive, "refresh", stand)
    return limit


@pytest.mark.parametrize(("mode", "controller"), [("csp", "pos"), ("csv", "vel")])
@pytest.mark.usefixtures("standing")
def test_an_enabled_axis_that_ignores_its_set_points_is_named_within_two_seconds(robot, mode, controller):
    created = robot(mode)
    created.command(controller, 0.5, 0.5, seconds=3)
    created.run(2.0)
    assert any(
        "pan_drive" in sentence and "does not follow its set-points" in sentence for sentence in sentences(created)
    )


@pytest.mark.parametrize("mode", ["csp", "pp", pytest.param("ip", marks=pytest.mark.rest)])
def test_an_axis_whose_feedback_is_mirrored_stops_in_every_mode_of_positions(robot, mode):
    created = robot(mode)
    for node_id in (2, 3):
        drive(created, node_id).readings.inverted.inject(True)
    for step in range(80):
        created.command("pos", 0.6 if mode == "pp" else 0.01 * (step + 1), 0.0)
        created.run(0.02)
    assert any("pan_drive" in sentence and "turns against its command" in sentence for sentence in sentences(created))
    assert created.state != "running"


@pytest.mark.parametrize("mode", ["pp", pytest.param("csp", marks=pytest.mark.rest)])
def test_an_axis_whose_feedback_is_mirrored_stops_after_a_motion_of_a_third_of_a_second(robot, mode):
    created = robot(mode)
    for node_id in (2, 3):
        drive(created, node_id).readings.inverted.inject(True)
        for index, value in ((0x6081, 2_000_000), (0x6083, 9_000_000), (0x6084, 9_000_000)):
            created.simulated.drives[node_id].device.store.set(index, 0, value)
    for step in range(60):
        created.command("pos", 0.5 if mode == "pp" else min(0.3, 0.04 * (step + 1)), 0.0)
        created.run(0.02)
    assert any("pan_drive" in sentence and "turns against its command" in sentence for sentence in sentences(created))
    assert created.state != "running"


@pytest.mark.rest
@pytest.mark.parametrize("mode", ["csp", "pp", "ip", "pv", "csv"])
def test_a_motion_and_its_way_back_are_not_deviation(robot, mode):
    created = robot(mode)
    controller = "vel" if mode in ("pv", "csv") else "pos"
    for step in range(150):
        value = 0.5 if step < 75 else -0.5
        created.command(controller, value if mode in ("pp", "pv", "csv") else 0.006 * min(step, 150 - step), 0.0)
        created.run(0.02)
    assert not [sentence for sentence in sentences(created) if "against" in sentence or "does not follow" in sentence]
    assert created.state == "running"


def _peak_speed(made):
    made.disable()
    made.run(1)
    made.enable()
    made.until(lambda: drive(made, 2).state is State.OPERATION_ENABLED, 3)
    peak = 0.0
    for step in range(60):
        made.command("pos", 0.01 * (step + 1), 0.0)
        made.run(0.02)
        peak = max(peak, abs(made.velocity("pan")))
    return peak


def test_a_settling_time_keeps_set_points_until_the_brake_has_lifted(robot, standing):
    standing["ms"] = 500
    assert _peak_speed(robot("csp", keys="enable_settle_ms: 600")) < 2.1


@pytest.mark.sources
def test_a_mode_of_bus_yml_that_0x6502_does_not_list_is_tried_and_named(robot, monkeypatch):
    monkeypatch.setattr(VirtualDrive, "_check_mode", lambda _self, _entry, value: value)
    attach = VirtualDrive._attach

    def without_csp(self):
        attach(self)
        self._store.preset(0x6502, 0, 0x001F0065)  # as Technosoft's iPOS shows it

    monkeypatch.setattr(VirtualDrive, "_attach", without_csp)
    created = robot("csp")
    assert created.state == "running"
    assert any("not CSP, which bus.yml selects" in sentence for sentence in sentences(created))


def _slow_display(monkeypatch, ms):
    """Show -1 in 0x6061 for a time after a change of mode, as Festo's CMMP-AS does while it synchronises."""
    attach, shown = VirtualDrive._attach, {}

    def slow(self):
        attach(self)
        source = self._store.source_of(0x6061, 0)

        def read():
            now, mode = self._clock.now, source()
            last, at = shown.get(id(self), (None, 0))
            if mode != last:
                shown[id(self)] = (mode, at := now)
            return -1 if mode == 7 and now - at < ms * MS else mode

        self._store.on_read(0x6061, 0, read)

    monkeypatch.setattr(VirtualDrive, "_attach", slow)


def test_a_mode_that_is_shown_late_has_its_own_time(robot, monkeypatch):
    _slow_display(monkeypatch, 4000)
    created = robot("ip", keys="mode_timeout_ms: 6000")
    assert created.state == "running"
    assert not [sentence for sentence in sentences(created) if "not confirmed" in sentence]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("velocity_mode: -3", "-3 is a manufacturer-specific mode"),
        ("velocity_mode: 11", "CSTCA does not support the velocity interface"),
        ("velocity_mode: 5", r"mode 5 \(reserved\) does not support the velocity interface"),
        ("velocity_mode: 8", "CSP does not support the velocity interface"),
    ],
)
def test_a_mode_that_cannot_serve_its_interface_is_refused_with_its_line(tmp_path, keys, message):
    path = folder(tmp_path, "csp", keys=keys)
    with pytest.raises(BusConfigError, match=rf"bus.yml:\d+.*{message}"):
        read_robot(find_robot(str(path)))


def test_a_bit_10_that_flickers_on_the_way_is_not_an_arrival(robot, monkeypatch):
    value, count = Statusword.value, itertools.count()
    monkeypatch.setattr(Statusword, "value", lambda self: value(self) ^ (0x400 if next(count) % 5 == 0 else 0))
    created = robot("pp")
    created.command("pos", 0.5, 0.5, seconds=1)
    while not any("pan_drive" in sentence and "reached" in sentence for sentence in sentences(created)):
        created.run(0.01)
    assert created.position("pan") == pytest.approx(0.5, abs=0.01)


@pytest.mark.rest
def test_a_set_point_that_a_drive_ignores_on_its_way_is_given_again(robot, monkeypatch):
    control = ProfilePosition.control

    def single(self, word, previous, now):
        if not word & ~previous & 0x10 or self.mover.at_standstill:
            control(self, word, previous, now)

    monkeypatch.setattr(ProfilePosition, "control", single)
    created = robot("pp")
    created.command("pos", 0.5, 0.5, seconds=0.4)
    created.run(0.4)
    created.command("pos", -0.3, -0.3, seconds=8)
    created.run(9)
    assert created.position("pan") == pytest.approx(-0.3, abs=0.01)
    assert any("sent again when the motion has ended" in sentence for sentence in sentences(created))
    assert not any("given up" in sentence for sentence in sentences(created))


def test_an_axis_whose_position_is_sent_on_one_of_many_syncs_is_not_a_standing_one(tmp_path):
    """With transmission type 240 the position is 2.4 s old, while the axis turns."""
    path = folder(tmp_path, "pv")
    bus = path / "bus.yml"
    bus.write_text(re.sub(r"(?m)^(    2: .*transmission: )1(, mapping: .*0x6064)", r"\g<1>240\2", bus.read_text()))
    tested_robot = TestedRobot(read_robot(find_robot(str(path))))
    try:
        tested_robot.run(3.0)
        tested_robot.command("vel", 0.1, 0.1, seconds=8)
        tested_robot.run(8.0)
        assert drive(tested_robot, 2).mover.plant.position > 0
        assert not [sentence for sentence in sentences(tested_robot) if "does not follow" in sentence]
    finally:
        tested_robot.close()


def _lead(made, mode, cycles):
    """Command a motion at 0.5 rad/s; return whether it was possible."""
    for _ in range(cycles):
        if mode in ("csp", "ip"):
            made.goal = getattr(made, "goal", 0.0) + 0.01
            made.command("pos", made.goal, made.goal)
        elif mode == "pp":
            made.command("pos", 2.5, 2.5)
        else:
            made.command("vel", 0.5, 0.5)
        made.run(0.02)


@pytest.mark.parametrize("mode", ["csp", "pp", pytest.param("pv", marks=pytest.mark.rest)])
def test_an_enabled_drive_that_loses_its_supply_stops_the_robot_and_does_not_move_when_it_returns(robot, mode):
    created = robot(mode)
    for item in created.drives:
        item.quirk("supply_loss_unseen")
    _lead(created, mode, 40)
    created.drives[2].fault("power_stage_off")
    _lead(created, mode, 40)
    assert created.state != "running"
    assert any("pan_drive" in sentence and "STO is active" in sentence for sentence in sentences(created))
    created.drives[2].clear_fault("power_stage_off")
    position = created.position("pan")
    created.run(1)
    created.enable()
    created.until(lambda: created.state == "running", 3)
    created.run(0.5)
    assert created.position("pan") == pytest.approx(position, abs=0.001)
    assert created.breaches == []


def test_an_axis_that_stops_following_in_csp_is_stopped_before_it_jumps_to_its_set_points(robot):
    """STO of a drive that does not show it at all."""
    created = robot("csp")
    created.disable()
    created.run(1)
    for item in created.drives:
        item.quirk("supply_loss_unseen")
        item.quirk("voltage_never")
    created.enable()
    created.until(lambda: created.state == "running", 3)
    _lead(created, "csp", 40)
    created.drives[2].fault("power_stage_off")
    _lead(created, "csp", 50)
    assert created.state != "running"
    assert any(
        "pan_drive" in sentence and "does not follow its set-points any more" in sentence
        for sentence in sentences(created)
    )
    created.drives[2].clear_fault("power_stage_off")
    created.run(0.5)
    assert created.stopped_within(0.0)
    assert created.breaches == []


@pytest.mark.parametrize("sync", [True, False])
def test_event_driven_feedback_that_is_lost_stops_the_robot_by_its_event_timer(tmp_path, sync):
    """A TPDO that is sent only when it changes says nothing by staying away; with an event timer it does."""
    path = folder(tmp_path, "pv")
    bus = path / "bus.yml"
    timed = r"transmission: 255, event_timer: 50\1"
    text = re.sub(r"transmission: 1(, mapping: \[{index: 0x60[46][14])", timed, bus.read_text())
    text = (
        text if sync else text.replace("  sync_period: 10000\n", "").replace("transmission: 1,", "transmission: 255,")
    )
    bus.write_text(text)
    tested_robot = TestedRobot(read_robot(find_robot(str(path))))
    try:
        tested_robot.command("vel", 0.5, 0.5, seconds=5)
        tested_robot.run(1.0)
        assert tested_robot.state == "running"
        tested_robot.drives[2].fault("tpdo_missing")
        assert tested_robot.until(lambda: tested_robot.state == "fault", 2) < 0.25
        assert tested_robot.stopped_within(0.5)
        assert any("0.15 s, three times its event timer" in sentence for sentence in sentences(tested_robot))
    finally:
        tested_robot.close()


@pytest.mark.sources  # stand-ins
@pytest.mark.parametrize(
    ("counts", "speed", "seconds", "stops"),
    [
        (4.0, 0.1, 3.0, []),  # a count takes 2.5 s
        (4.0, 0.1, 9.0, [True]),
        (1000.0, 0.1, 2.0, [False]),  # 0.2 rad are missing
        (1000.0, 0.1, 4.0, [False, True]),
        (1000.0, 1.0, 4.0, [True]),
    ],
)
def test_a_standing_wheel_stops_its_base_once_the_missing_way_counts(counts, speed, seconds, stops):
    pdo = SimpleNamespace(every=1, count=0, stamp=0)
    axis = SimpleNamespace(
        position=SimpleNamespace(pdo=pdo, fresh=True),
        velocity=None,
        raw_position=0,
        unwrap=PositionUnwrapper(),
        scale=Scale(counts, 1 / counts, 1000.0, 0.001),
        limits=AxisObjectLimits(),
    )
    machine = SimpleNamespace(halted=False, statusword=0x0637)
    target = VelocityTarget(axis, SimpleNamespace(value=round(1000 * speed)), machine)
    watch, events = MotionWatch(axis, machine), []
    for _ in range(round(seconds / 0.1)):
        watch.check(target, enabled=True)
        events += watch.events(wrong_way=False, in_base=True)
    assert [event.stops for event in events] == stops


@pytest.mark.parametrize("mode", ["csp", "ip", "pp"])
@pytest.mark.parametrize("way", [50_000, pytest.param(4_000_000, marks=pytest.mark.rest)])
def test_a_standing_axis_whose_encoder_is_corrected_stops_instead_of_moving_by_the_correction(robot, mode, way):
    """0.1 rad, or more than a turn of the joint."""
    created = robot(mode)
    mover = drive(created, 2).mover
    mover.plant = LoadedPlant(position=mover.plant.position, acceleration=10e6)
    _lead(created, mode, 20)
    if mode == "pp":
        created.command("pos", 0.2, 0.2)
    created.run(3.5)
    before = mover.plant.position
    drive(created, 2).objects.units.lose_counts(way)
    farthest = 0.0
    for _ in range(100):
        created.run(0.01)
        farthest = max(farthest, abs(mover.plant.position - before))
    assert farthest < 3000, "0.006 rad"
    assert any("pan_drive" in sentence and f"(0x6064) jumped by {way}" in sentence for sentence in sentences(created))
    assert created.state == "disabled"


def test_a_standing_axis_that_is_pushed_has_not_jumped(robot):
    """Its velocity shows the motion."""
    created = robot("csp")
    mover = drive(created, 2).mover
    mover.plant = LoadedPlant(position=mover.plant.position, acceleration=1e6, position_gain=5.0)
    created.run(1.0)
    mover.plant.external = 1500.0
    for _ in range(30):
        created.run(0.01)
    mover.plant.external = 0.0
    created.run(1.0)
    assert not any("jumped" in sentence for sentence in sentences(created))
    assert created.state == "running"


def _jumps(created):
    """Return the sizes of the reported jumps of the pan axis."""
    jumps = [event for event in created.events if (event.kind, event.node) == ("position_jump", "pan_drive")]
    return [int(re.search(r"jumped by (-?\d+)", event.text)[1]) for event in jumps]


def _moving(robot, mode, sign=1.0):
    """Return a robot whose pan axis moves at 0.5 rad/s, and its shaft with a stiff position loop."""
    created = robot(mode)
    mover = drive(created, 2).mover
    mover.plant = LoadedPlant(position=mover.plant.position, acceleration=10e6)
    created.goal = 0.0
    for _ in range(60):
        created.goal += sign * 0.01
        created.command("pos", created.goal, created.goal)
        created.run(0.02)
    return created, mover


@pytest.mark.parametrize(
    ("mode", "way"), [("csp", 50_000), ("csp", -50_000), pytest.param("ip", 50_000, marks=pytest.mark.rest)]
)
def test_a_moving_axis_whose_encoder_is_corrected_stops_on_its_way(robot, mode, way):
    """By 0.1 rad, against the motion and with it."""
    created, mover = _moving(robot, mode)
    before = mover.plant.position
    drive(created, 2).objects.units.lose_counts(way)
    places = []
    for _ in range(150):
        created.run(0.01)
        places.append(mover.plant.position)
    assert _jumps(created) == pytest.approx([way], abs=3000)
    assert before - 3000 < min(places), "it does not turn back by the correction"
    assert max(places) < before + 50_000 + 3000, "the ramp of a stop from 0.5 rad/s: 0.08 rad, and the following error"
    assert created.state == "disabled"


@pytest.mark.rest
def test_fast_motions_shocks_and_late_cycles_are_no_corrections(robot):
    created, mover = _moving(robot, "csp")
    for step in range(200):
        created.goal += 0.03 if step % 40 < 20 else -0.03
        created.command("pos", created.goal, created.goal)
        mover.plant.external = 600.0 if step % 7 == 0 else 0.0
        if step % 30 == 0:
            created.stall(0.03)
        created.run(0.02)
    assert not any("jumped" in sentence for sentence in sentences(created))
    assert created.state == "running"


class _Shown:
    """Frames of a drive whose TPDO 2 shows another position and velocity than that of its shaft while `on`.

    The velocity is 0 in one of ten SYNCs, at which the position is `amplitude` counts away on alternate sides.
    """

    def __init__(self, amplitude):
        self.on, self._count, self._amplitude = True, 0, amplitude

    def __call__(self, _node, frame, _now):
        if frame.can_id == 0x282 and self.on:
            self._count += 1
            position = int.from_bytes(frame.data[:4], "little", signed=True)
            position += round(self._amplitude * math.cos(math.tau * self._count / 20))
            velocity = 200_000 if self._count % 10 else 0
            data = b"".join(value.to_bytes(4, "little", signed=True) for value in (position, velocity))
            return [(0, CanFrame(frame.can_id, data))]
        return [(0, frame)]

    def attach(self, device):
        """Change the frames of a virtual device from now on."""
        switches = device.fault_switches or FaultSwitches(device)
        switches.set_quirks((self,), ())
        return self


@pytest.mark.parametrize("action", ["disable", "quick-stop"])
def test_an_oscillating_axis_is_not_disabled_at_a_turning_point(robot, action):
    created = robot("csv")
    for simulated in created.simulated.drives.values():
        simulated.device.store.set(0x605A, 0, 6)  # stays in QUICK STOP ACTIVE
    oscillation = _Shown(10_000).attach(created.simulated.drives[2].device)
    created.run(0.5)
    created.do("axis", name=action)
    created.run(1.5)
    phase = created.simulated.core.joints["pan"].statechart.state
    assert phase in (AxisPhase.AWAITING_STANDSTILL, AxisPhase.QUICK_STOPPING)
    oscillation.on = False
    created.run(0.3)
    assert created.simulated.core.joints["pan"].statechart.state in STOPPED


def test_a_velocity_that_flickers_at_standstill_does_not_delay_the_end_of_a_stop(robot):
    created = robot("csv")
    _Shown(0).attach(created.simulated.drives[2].device)
    created.run(0.5)
    created.disable()
    created.until(lambda: created.state == "disabled", 0.6)


class _Glitch:
    """Frames of a drive of which one shows a position that is wrong by `way` counts."""

    def __init__(self, way):
        self._way, self._count = way, 0

    def __call__(self, _node, frame, _now):
        self._count += frame.can_id == 0x282
        if frame.can_id != 0x282 or self._count != 5:
            return [(0, frame)]
        position = int.from_bytes(frame.data[:4], "little", signed=True) + self._way
        return [(0, CanFrame(frame.can_id, position.to_bytes(4, "little", signed=True) + frame.data[4:]))]


@pytest.mark.parametrize(("way", "moves"), [(16_000, False), (-100_000, False), (52_000, True)])
def test_a_single_wrong_position_moves_an_axis_only_for_a_cycle_and_leaves_no_offset(robot, way, moves):
    created, mover = _moving(robot, "csp")
    if not moves:
        created.run(1.5)
    device = created.simulated.drives[2].device
    (device.fault_switches or FaultSwitches(device)).set_quirks((_Glitch(way),), ())
    before, places = mover.plant.position, []
    for _ in range(100):
        created.run(0.01)
        places.append(mover.plant.position - before)
    assert _jumps(created) == pytest.approx([way, -way], abs=3000)
    assert -2500 < min(places) < max(places) < 2500 + (56_000 if moves else 0), "0.005 rad, and the ramp of the stop"
    assert created.position("pan") == pytest.approx(mover.plant.position / 65536 / 50 * math.tau, abs=0.001)
    assert created.state == "disabled"


class _Frozen:
    """Frames of a drive whose position stands at its first value."""

    def __init__(self):
        self._position = None

    def __call__(self, _node, frame, _now):
        if frame.can_id != 0x282:
            return [(0, frame)]
        self._position = self._position or frame.data[:4]
        return [(0, CanFrame(frame.can_id, self._position + frame.data[4:]))]


@pytest.mark.parametrize("action", ["stop", "warn"])
def test_a_position_that_stands_while_the_velocity_shows_a_motion_stops_the_robot(robot, action):
    created = robot("pv", keys=f"following_error_action: {action}")
    _lead(created, "pv", 50)
    device = created.simulated.drives[2].device
    (device.fault_switches or FaultSwitches(device)).set_quirks((_Frozen(),), ())
    before = drive(created, 2).mover.plant.position
    _lead(created, "pv", 100)
    found = [event for event in created.events if event.kind == "position_stands"]
    assert [event.node for event in found] == ["pan_drive"]
    assert (created.state == "running") is (action == "warn")
    if action == "stop":
        assert (drive(created, 2).mover.plant.position - before) / COUNTS < 0.5


def _switch_off_rpdos(created, *numbers):
    """Set bit 31 of the COB-IDs of RPDOs, as a drive did by itself while it showed OPERATION_ENABLED."""
    store = created.simulated.drives[2].device.store
    for number in numbers:
        entry = store.od.get(0x1400 + number - 1, 1)
        store.write(entry, store.number(entry.index, 1) | 1 << 31)


@pytest.mark.parametrize("rpdos", [(2,), (1, 2)])
@pytest.mark.parametrize("mode", ["pv", pytest.param("csv", marks=pytest.mark.rest)])
def test_a_drive_without_rpdos_is_stopped_by_sdo_when_it_moves_on_at_a_command_of_0(robot, mode, rpdos):
    """Nature Robots' ros2_canopen has a watchdog that repairs such drives."""
    created = robot(mode)
    _lead(created, mode, 50)
    _switch_off_rpdos(created, *rpdos)
    mover = drive(created, 2).mover
    created.command("vel", 0.0, 0.0)
    created.run(1.9)
    assert (created.state, abs(mover.plant.velocity) > 0.4 * COUNTS) == ("running", True)
    created.run(0.8)
    assert created.state == "disabled"
    assert mover.plant.velocity == 0.0
    found = [event for event in created.events if event.kind == "runs_on"]
    assert [event.node for event in found] == ["pan_drive"]
    assert "bit 31 of 0x1400:01 or 0x1401:01" in found[0].sentence
    assert "quick stop commanded" in "; ".join(sentences(created))


def test_a_drive_without_rpdos_is_stopped_when_it_stays_faster_than_its_command(robot):
    created = robot("pv")
    _lead(created, "pv", 50)
    _switch_off_rpdos(created, 2)
    created.command("vel", 0.1, 0.1, seconds=4)
    created.run(1.9)
    assert created.state == "running"
    created.run(1.0)
    assert (created.state, drive(created, 2).mover.plant.velocity) == ("disabled", 0.0)
    found = [event.sentence for event in created.events if event.kind == "runs_on"]
    assert [sentence.split("; ")[0] for sentence in found] == [
        "node 2 (pan_drive): it moves faster than commanded and does not slow down"
    ]


def test_a_stop_does_not_wait_for_a_drive_that_does_not_slow_down(robot):
    created = robot("pv")
    _lead(created, "pv", 50)
    _switch_off_rpdos(created, 1, 2)
    created.do("axis", name="disable")
    created.run(2.7)
    assert drive(created, 2).mover.plant.velocity == 0.0
    assert not drive(created, 2).power.state.name.startswith("OPERATION")


def test_an_axis_that_is_only_warned_about_is_not_stopped(robot):
    created = robot("pv", keys="following_error_action: warn")
    _lead(created, "pv", 50)
    _switch_off_rpdos(created, 2)
    created.command("vel", 0.0, 0.0)
    created.run(3.0)
    assert [(event.kind, created.state) for event in created.events if event.kind == "runs_on"] == [
        ("runs_on", "running")
    ]


@pytest.mark.parametrize("velocity", [0.0, 0.1])
def test_a_slow_ramp_is_no_drive_that_moves_on(robot, velocity):
    created = robot("pv")
    _lead(created, "pv", 50)
    store = created.simulated.drives[2].device.store
    store.write(store.od.get(0x6084, 0), round(0.02 * COUNTS))  # 0.5 rad/s in 25 s
    created.command("vel", velocity, velocity)
    created.run(15.0)
    assert not [event for event in created.events if event.kind == "runs_on"]


def test_the_minimum_velocity_of_mode_vl_is_no_drive_that_moves_on(robot):
    created = robot("vl")
    _lead(created, "vl", 50)
    store = created.simulated.drives[2].device.store
    store.write(store.od.get(0x6046, 1), 240)  # rpm of the motor: 0.5 rad/s
    created.command("vel", 0.1, 0.1, seconds=4)
    created.run(4.0)
    assert abs(drive(created, 2).mover.plant.velocity) > 0.4 * COUNTS
    assert not [event for event in created.events if event.kind == "runs_on"]
