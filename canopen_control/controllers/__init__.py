"""ros2_control's controllers and their manager."""
