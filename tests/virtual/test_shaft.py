"""Encoders on the shafts of virtual drives: gear, direction, backlash, in one process and in two."""

import math

import pytest
from support.devices import put
from support.robots import dictionary_of
from support.virtualbench import Bench, servo_od

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.virtual.device import make_device, make_devices
from canopen_control.virtual.plant import IndependentPlants, LoadedPlant
from canopen_control.virtual.plant_file import WorldError, read_world
from canopen_control.virtual.shaft import Coupling, ShaftFile, ShaftWorld, WheelPlant, load_counts

DRIVE, ENCODER = 3, 5
EDS = data_path("eds", "generic_cia406.eds")
SHAFT = 'encoders: {"5": {axis: "3", counts_per_revolution: 1000, gear: 2, reversed: true%s}}'


def worlds(tmp_path, count=1, text=SHAFT, more=""):
    path = tmp_path / "plant.yml"
    path.write_text(text % more)
    return [read_world(path) for _ in range(count)]


def driving(world):
    """Return a drive of a world that turns with 1000 counts/s."""
    bench = Bench(make_device(servo_od(DRIVE), DRIVE, plant=lambda axis: world.plant(DRIVE, axis)))
    bench.enable(3)
    bench.write(0x60FF, 1000)
    return bench


def measured(world):
    """Return an encoder on a shaft of a world."""
    bench = Bench(make_device(dictionary_of(EDS), ENCODER)).on(0.1)
    bench.node.function.follow(world, ENCODER)
    return bench


@pytest.mark.parametrize("shared", [False, True])
def test_an_encoder_shows_how_a_drive_has_moved_behind_its_gear(tmp_path, shared):
    more = f", share: {tmp_path}/shafts" if shared else ""
    created = worlds(tmp_path, 2 if shared else 1, more=more)
    encoder, drive = measured(created[-1]), driving(created[0])
    for _ in range(20):
        drive.on(0.1)
        created[0].publish()
        encoder.on(0.1)
    turns = drive.drive.mover.plant.position / 1000 / 2
    assert turns > 0.5
    assert encoder.number(0x6004) == (-round(turns * 4096)) % (1 << 24)
    drive.write(0x60FF, 0)
    for _ in range(5):
        drive.on(0.1)
        created[0].publish()
        encoder.on(0.1)
    stands = encoder.number(0x6004)
    assert encoder.on(1.0).number(0x6004) == stands
    for item in created:
        item.close()


def test_it_is_where_the_drive_is_known_to_be_and_until_then_where_it_was(tmp_path):
    (world,) = worlds(tmp_path, more=f", share: {tmp_path}/shafts")
    assert world.shaft_position(ENCODER) is None  # not reported yet
    assert not world.has_shaft(4)
    encoder = measured(world)
    assert encoder.number(0x6004) == 0
    ShaftFile(tmp_path / "shafts").put(DRIVE, 0, -500.0)
    assert encoder.on(0.02).number(0x6004) == 1024
    world.close()


def test_what_leads_it_cannot_be_set(tmp_path):
    encoder = measured(*worlds(tmp_path))
    with pytest.raises(ConfigError, match="position follows the shaft"):
        put(encoder, position=1.0)
    with pytest.raises(ConfigError, match="velocity follows the shaft"):
        put(encoder, velocity=1.0)


def test_processes_of_drives_couple_what_the_file_specifies(tmp_path):
    plant = tmp_path / "plant.yml"
    plant.write_text(SHAFT % "")
    devices = make_devices((ENCODER, 6), EDS, print, plant=plant)
    assert isinstance(devices.world, ShaftWorld)
    coupled, free = devices.nodes
    with pytest.raises(ConfigError, match="the shaft"):
        coupled.function.set_signals({"position": 1.0}, 0)
    free.function.set_signals({"position": 1.0}, 0)
    assert devices.world.period_ns == 5_000_000
    assert not isinstance(IndependentPlants(), ShaftWorld)


@pytest.mark.parametrize(
    ("coupling", "place"),
    [
        (Coupling(1000), math.tau / 4),
        (Coupling(1000, gear=10), math.tau / 40),
        (Coupling(1000, reversed=True), -math.tau / 4),
        (Coupling(1000, gear=0.5, lead=0.005), 0.0025),
    ],
)
def test_a_coupling_is_gear_direction_and_lead(coupling, place):
    assert coupling.place(250.0) == pytest.approx(place)


def test_the_load_is_behind_its_backlash_also_of_a_wheel():
    loaded = LoadedPlant(position=100.0, backlash=20.0, load_position=90.0)
    assert load_counts(loaded) == 90.0
    assert load_counts(WheelPlant(loaded, None, 0, 0.001)) == 90.0
    assert load_counts(LoadedPlant(position=100.0)) == 100.0


def test_errors_are_reported_with_their_line(tmp_path):
    with pytest.raises(WorldError) as caught:
        worlds(tmp_path, text='encoders: {"x": {axis: "3/9", counts_per_revolution: 0}}%s')
    assert "'x' is not a node" in str(caught.value) or "counts_per_revolution" in str(caught.value)
    with pytest.raises(WorldError, match=r"'3/9' is not a node or axis: write \"5\" for node 5"):
        worlds(tmp_path, text='encoders: {"5": {axis: "3/9", counts_per_revolution: 1}}%s')
    with pytest.raises(ConfigError, match="cannot be shared"):
        ShaftFile(tmp_path / "nowhere" / "shafts").get(3, 0)
