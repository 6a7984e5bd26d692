"""Controllers of ros2_control and their manager."""
