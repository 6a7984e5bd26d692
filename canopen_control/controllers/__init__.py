"""Controllers modelled on ros2_control and ros2_controllers, and the controller manager."""
