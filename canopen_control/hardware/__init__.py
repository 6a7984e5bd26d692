"""Hardware components as in ros2_control: interfaces, and plugins for CANopen drives, mock hardware and simulation."""
