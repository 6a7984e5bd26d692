"""Readers of robot descriptions (URDF and xacro), including <ros2_control> tags, links, joints, meshes and packages."""
