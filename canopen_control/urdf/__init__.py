"""Readers of robot descriptions (URDF and xacro): <ros2_control> tags, links, joints, meshes and packages."""
