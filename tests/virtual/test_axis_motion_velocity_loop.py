import cmath
import math

import pytest

from canopen_control.commissioning.tune_gains import PlantModel, design_velocity_loop
from canopen_control.virtual.axis_motion import PERIOD_NS, VelocityLoop
from canopen_control.virtual.plant import IdealPlant, LoadedPlant, ServoGains
from canopen_control.virtual.trajectory import cruise, hold, ramp_to

S = 1_000_000_000
INERTIA = 1000 * 2.5 / 2e6  # per mille s^2/count
VISCOUS, COULOMB = 0.0005, 40.0
DELAY_S = 0.5 * PERIOD_NS * 1e-9  # of a torque that is held


def plant():
    return LoadedPlant(acceleration=2e6, inertia=1.5, friction=COULOMB, viscosity=VISCOUS, torque_limit=3000.0)


def designed(hertz, degrees):
    model = PlantModel(INERTIA, VISCOUS, COULOMB, load=0.0, delay=0.0, fit=1.0)
    return design_velocity_loop(model, hertz * math.tau, math.radians(degrees), DELAY_S)


def run(loop, moved, demand, start, seconds, *, velocity_only=True, limit=math.inf, step=10_000_000):
    end = start + round(seconds * S)
    for now in range(start, end, step):
        loop.follow(moved, demand, now, min(now + step, end), limit, velocity_only=velocity_only)
    return end


@pytest.mark.parametrize(("hertz", "degrees"), [(10, 60), (20, 60), (20, 45), (50, 60)])
def test_the_margin_that_was_designed_is_the_one_it_has(hertz, degrees):
    design = designed(hertz, degrees)
    loop, moved = VelocityLoop(ServoGains(design.velocity_p, design.velocity_i, 0.0, 1.0)), plant()
    omega, command, shown = hertz * math.tau, [], []
    for k in range(round(2.0 / 0.0005)):
        now, point = k * PERIOD_NS, (k + 1) * PERIOD_NS
        speed = 20_000.0 + 4_000.0 * math.sin(omega * point / S)
        loop.follow(moved, cruise(now, 0.0, speed), now, now + PERIOD_NS, math.inf, velocity_only=True)
        if now >= S:
            turn = cmath.exp(complex(0.0, -omega * point / S))
            command.append(speed * turn)
            shown.append(moved.velocity * turn)
    closed = sum(shown) / sum(command)
    opened = closed / (1.0 - closed)
    assert abs(opened) == pytest.approx(1.0, abs=0.05)
    assert 180.0 + math.degrees(cmath.phase(opened)) == pytest.approx(degrees, abs=3.0)


def test_the_result_does_not_depend_on_the_time_of_reading():
    ends = []
    for step in (10_000_000, 730_001):
        loop, moved = VelocityLoop(ServoGains(0.5, 20.0, 30.0, 1.0)), plant()
        run(loop, moved, ramp_to(0, 0.0, 0.0, 20_000.0, 100_000.0, 100_000.0), 0, 0.4, velocity_only=False, step=step)
        ends.append((moved.position, moved.velocity, moved.torque))
    assert ends[0] == ends[1]


def test_a_position_is_held_against_a_load():
    loop, moved = VelocityLoop(ServoGains(0.5, 20.0, 30.0, 1.0)), plant()
    moved.external = 300.0
    run(loop, moved, hold(0, 1000.0), 0, 3.0, velocity_only=False)
    assert moved.position == pytest.approx(1000.0, abs=2.0)
    assert abs(moved.torque) == pytest.approx(300.0, abs=COULOMB + 1.0)


def test_a_velocity_is_not_made_up_for():
    """In the modes of operation that command a velocity, way that was lost while it was blocked stays lost."""
    loop, moved = VelocityLoop(ServoGains(0.5, 20.0, 30.0, 1.0)), plant()
    moved.stalled = True
    now = run(loop, moved, cruise(0, 0.0, 10_000.0), 0, 0.5, limit=500.0)
    moved.stalled = False
    run(loop, moved, cruise(0, 0.0, 10_000.0), now, 2.0, limit=500.0)
    assert moved.velocity == pytest.approx(10_000.0, rel=0.01)
    assert moved.position == pytest.approx(20_000.0, rel=0.05)


@pytest.mark.parametrize(("limit", "most"), [(200.0, 200.0), (math.inf, 3000.0)])
def test_nothing_winds_up_at_the_limit_of_the_drive_or_of_the_motor(limit, most):
    loop, moved = VelocityLoop(ServoGains(5.0, 200.0, 0.0, 1.0)), plant()
    now = run(loop, moved, cruise(0, 0.0, 1e7), 0, 0.3, limit=limit)
    assert moved.torque == pytest.approx(most)
    run(loop, moved, cruise(now, 0.0, 0.0), now, 0.02, limit=limit)
    assert moved.torque <= 0.0


def test_what_is_fed_forward_is_added():
    loop, moved = VelocityLoop(ServoGains(0.5, 0.0, 0.0, 0.0)), IdealPlant()
    loop.fed = (0.0, 100.0)
    run(loop, moved, hold(0, 0.0), 0, 0.001, velocity_only=False)
    assert moved.torque == pytest.approx(100.0, abs=5.0)
    loop.rest()
    assert loop.fed == (0.0, 0.0)
