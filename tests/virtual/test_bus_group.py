import types

import pytest

from canopen_control.data_files import data_path
from canopen_control.virtual import bus_group
from canopen_control.virtual.bus_group import GroupError, read_group, run_group
from canopen_control.virtual.plant import IndependentPlants

GROUP = """engine: mujoco
world: hall.yml
robots:
  a: {plant: a.yml, buses: {can: {channel: "memory:group-a", nodes: {"2": EDS, "3": EDS}}}}
  b: {plant: b.yml, buses: {can: {channel: "memory:group-b", nodes: {"2": EDS}}}}
"""


def written(tmp_path, text=GROUP):
    path = tmp_path / "buses.yml"
    path.write_text(text.replace("EDS", str(data_path("eds", "TMCM-1270.eds"))))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("world: hall.yml", "", "several robots need the file with their start poses"),
        ("group-b", "group-a", "a bus needs nodes, and a channel"),
        ('{"2": EDS}', '{"200": EDS}', "'200' is not a node-ID: 1 to 127"),
        ('"3": EDS}', '"3": EDS}, objects: {"4": {"0x1018:04": 5}}', "objects of '4': give a node-ID of `nodes`"),
        ('"3": EDS}', '"3": EDS}, objects: {"3": {serial: 5}}', "objects of '3': .*such as 0x1018:04"),
        ("mujoco", "gazebo", "engine"),
        ("plant: b.yml, ", "", "plant"),
    ],
)
def test_errors_are_reported(tmp_path, old, new, message):
    text = GROUP.replace('channel: "memory:group-b"', 'channel: "memory:group-a"') if old == "group-b" else GROUP
    with pytest.raises(GroupError, match=message):
        read_group(written(tmp_path, text.replace(old, new)))


class Shared(IndependentPlants):
    """A world that notes who asks for a side of it."""

    def __init__(self):
        self.notes, self.sides, self.closed = ("guessed",), [], False

    def side(self, robot, bus=""):
        self.sides.append((robot, bus))
        return IndependentPlants()

    def close(self):
        self.closed = True


def test_all_buses_are_served_on_their_sides_of_one_world(tmp_path, monkeypatch):
    shared, lines, created, serials = Shared(), [], [], []
    engine = types.SimpleNamespace(
        make_shared=lambda plants, where: created.append((list(plants), where.name)) or shared
    )
    monkeypatch.setattr(bus_group.importlib, "import_module", lambda _name: engine)

    class Ending(bus_group.DriveProcess):
        def run(self):
            self._look()
            return super().run()

        def _look(self):
            """Again and again: a stop that came while the buses are opened would be forgotten."""
            serials[:] = [node.store.number(0x1018, 4) for bus in self._buses for node in bus.nodes]
            if sum("ready on" in line for line in lines) == 2:
                self._reactor.stop()
            self._reactor.call_later(20_000_000, self._look)

    monkeypatch.setattr(bus_group, "DriveProcess", Ending)
    text = GROUP.replace('"3": EDS}', '"3": EDS}, objects: {"3": {"0x1018:04": 77}}')
    assert run_group(written(tmp_path, text), lines.append) == 0
    assert serials == [2, 77, 2]
    assert created == [(["a", "b"], "hall.yml")]
    assert shared.sides == [("a", ""), ("b", "")]
    assert shared.closed
    assert lines[0] == "world: guessed"
    assert [line for line in lines if "ready on" in line] == [
        "drives 2, 3 (TMCM-1270) ready on memory:group-a",
        "drive 2 (TMCM-1270) ready on memory:group-b",
    ]
