"""CANopen and CiA 402 drives for robots: master, virtual drives and ros2_control's world in Python."""

__version__ = "0.1.0"
