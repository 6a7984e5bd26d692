"""ros2_control's hardware components: interfaces, the robot's description, CANopen drives and their stand-in."""
