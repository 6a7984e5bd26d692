"""Hardware components as in ros2_control: interfaces, the description, CANopen drives and their simulation."""
