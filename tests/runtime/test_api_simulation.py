"""A simulation that is paused, stepped and reset, over the wire; in simulated time, where a cycle is 20 ms."""

import pytest
from support.apiclient import Client
from support.robots import Bench

from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.status import state_sample

BASE = "diff_drive_base_controller"
CYCLE = 0.02


class Simulated(Bench):
    """The bundled robot of Gazebo's plugin, with its API and a client of it."""

    def __init__(self, **how):
        super().__init__("simulation", config="diffbot_sim", drives=(), **how)
        self.api = ApiServer(self.robot)
        self.start()
        self.client = Client(self)
        self.run(500)

    def twist(self, speed):
        answer = self.client.ask("twist", controller=BASE, linear=speed, angular=0.0, dead_man=True)
        assert answer.get("result") == {}, answer

    def drive(self, speed, cycles):
        for _ in range(cycles):
            self.twist(speed)
            self.run(20)

    def ask(self, method, **params):
        answer = self.client.ask(method, **params)
        return answer["result"] if "result" in answer else answer["error"]["message"]

    @property
    def seconds(self):
        return self.ask("simulation")["seconds"]

    @property
    def pose(self):
        pose = self.robot.manager.get(BASE).pose
        return pose.x, pose.y, pose.heading

    @property
    def wheels(self):
        return [self.robot.registry.state(f"{side}_wheel_joint/position").value for side in ("left", "right")]


@pytest.fixture(params=[False, True], ids=["motors", "physics"])
def robot(request):
    bench = Simulated(simulate=request.param)
    yield bench
    bench.client.close()
    bench.api.close()
    bench.close()


def test_while_it_is_paused_time_and_joints_stand(robot):
    robot.drive(0.3, 40)
    assert robot.ask("pause_simulation", paused=True)["paused"]
    seconds, wheels = robot.seconds, robot.wheels
    robot.run(3000)
    assert (robot.seconds, robot.wheels) == (seconds, wheels)
    assert "canopen-control world play" in robot.ask("status")["hint"]


def test_steps_are_cycles_and_exactly_as_many_as_were_asked_for(robot):
    assert "pause it first" in robot.ask("step_simulation", steps=1)
    robot.ask("pause_simulation", paused=True)
    before = robot.seconds
    for steps in (1, 3, 250):
        before += steps * CYCLE
        assert robot.ask("step_simulation", steps=steps)["seconds"] == pytest.approx(before, abs=1e-9)
        robot.run(500)
        assert robot.seconds == pytest.approx(before, abs=1e-9)


def test_what_is_commanded_in_a_pause_is_stepped_and_runs_out_in_simulated_time(robot):
    robot.ask("pause_simulation", paused=True)
    robot.run(2000)
    robot.twist(0.3)
    robot.run(2000)  # its time-out is 0.5 s
    start = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    moved = robot.pose[0] - start
    assert moved > 0.05
    robot.ask("step_simulation", steps=100)
    rested = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    assert robot.pose[0] == pytest.approx(rested, abs=1e-3)


def test_a_command_from_before_is_not_executed_when_it_goes_on(robot):
    robot.ask("pause_simulation", paused=True)
    robot.twist(0.3)
    robot.ask("pause_simulation", paused=False)
    start = robot.pose[0]
    robot.run(300)
    assert robot.pose[0] == pytest.approx(start, abs=1e-3)
    robot.drive(0.3, 20)
    assert robot.pose[0] > start + 0.02


def test_after_a_pause_the_time_goes_on_where_it_stood(robot):
    robot.ask("pause_simulation", paused=True)
    before = robot.seconds
    robot.run(5000)
    robot.ask("pause_simulation", paused=False)
    robot.run(100)
    assert robot.seconds == pytest.approx(before + 0.1, abs=0.05)


def test_reset_brings_back_the_start_and_enables_nothing(robot):
    start = robot.wheels
    robot.ask("switch", deactivate=["joint_state_broadcaster"], activate=[])
    robot.drive(0.3, 60)
    before, states = robot.seconds, robot.robot.manager.states
    assert robot.pose[0] > 0.1
    robot.ask("reset_simulation")
    assert robot.robot.manager.states == states
    robot.run(100)
    assert robot.wheels == pytest.approx(start, abs=1e-3)
    assert robot.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert robot.seconds > before
    robot.events.clear()
    assert "key frame 'home'" in robot.ask("reset_simulation", keyframe="home")
    assert robot.events == []


def test_what_happens_in_the_world_is_told_with_who_asked_for_it(robot):
    if not robot.ask("simulation")["changeable"]:
        assert "simple motors move" in robot.ask("push", force=[0.0, 30.0, 0.0])
        return
    robot.events.clear()
    assert robot.ask("payload", mass=5.0) == {}
    assert robot.ask("push", force=[0.0, 30.0, 0.0], on="base_link") == {}
    assert robot.ask("block", joint="left_wheel_joint") == {}
    assert robot.ask("grip", friction=0.2) == {}
    texts = [event.text for event in robot.events if event.kind == "world"]
    assert [text.split(",")[0] for text in texts] == [
        "a payload of 5 kg is put on the heaviest link",
        "base_link is pushed with 0",
        "left_wheel_joint is blocked",
        "the floor has a friction of 0.2",
    ]
    assert all(text.endswith("asked for it") for text in texts)
    robot.drive(0.3, 50)
    left, right = robot.wheels
    assert abs(left) < 0.05 < 1.0 < right
    robot.ask("reset_simulation")
    robot.drive(0.3, 50)
    assert robot.wheels[0] == pytest.approx(robot.wheels[1], rel=0.1)
    robot.events.clear()
    assert "no drive moves a joint 'left'; known: left_wheel_joint" in robot.ask("block", joint="left")
    assert robot.events == []


def test_a_stop_and_the_end_work_in_a_pause(robot):
    robot.ask("pause_simulation", paused=True)
    robot.twist(0.3)
    assert robot.ask("stop") == {}
    start = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    assert robot.pose[0] == pytest.approx(start, abs=1e-3)
    robot.robot.shutdown("the test is over")
    robot.run(100)
    assert robot.robot.state.value == "stopped"


def test_stamps_are_the_simulations_after_every_pause(robot):
    for _ in range(2):
        robot.ask("pause_simulation", paused=True)
        robot.run(700)
        robot.ask("step_simulation", steps=2)
        robot.ask("pause_simulation", paused=False)
        robot.run(60)
        sample = state_sample(robot.robot)
        told = sample.samples["joint_state_broadcaster"].time - sample.sim_epoch
        assert told == pytest.approx(sample.sim_time, abs=1e-6)


@pytest.mark.parametrize(("method", "params"), [("simulation", {}), ("step_simulation", {"steps": 1})])
def test_drives_on_a_bus_have_a_time_of_their_own(robby, client, method, params):
    assert "robby has drives on a bus" in client.ask(method, **params)["error"]["message"]
