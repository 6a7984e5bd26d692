"""ROS 2 bridge: a process that connects a running robot to ROS; only this subpackage imports rclpy.

The bridge is a client of the runtime's API. Its actions, and its end, affect the control loop only through commands
that any client may send.
"""
