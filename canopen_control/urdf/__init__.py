"""Robot descriptions: URDF and xacro, the <ros2_control> tags in them, and the geometry of links and joints."""
