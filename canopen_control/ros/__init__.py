"""ROS 2: a process of its own that shows a running robot to rclpy, and the only subpackage that imports it.

It is a client of the runtime's API and nothing else. What it does, and its death, never reach the
control loop but as commands that any client may send.
"""
