"""Hardware components as in ros2_control: their interfaces, and the plugins for CANopen drives, mock and simulation."""
