"""Stream a robot's state over its socket: ten samples at 20 Hz."""

from canopen_control import Robot, RobotClient
from canopen_control.rpc.messages.robot import CommandController, Subscribe
from canopen_control.rpc.messages.state import StateSample

with (
    Robot.from_config("robby", can="memory:state_stream") as robot,
    RobotClient.connect(robot.name) as client,
):
    client.ask(Subscribe(state_rate=20.0))
    samples = 0
    for message in client.messages(timeout=1.0):
        if not isinstance(message, StateSample):
            continue
        client.ask(CommandController(controller="robby_forward_controller", values=[5.0, 5.0]))
        speeds = [joint.velocity for joint in message.joints.values()]
        print(message.state, *(f"{speed:.2f}" for speed in speeds if speed is not None))
        samples += 1
        if samples == 10:
            break
