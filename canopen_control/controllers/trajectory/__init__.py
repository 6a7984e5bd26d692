"""Joint trajectories, as executed by joint_trajectory_controller of ros2_controllers.

The code only computes: no clock is read and nothing is sent. Times are integer nanoseconds, angles rad, lengths m.
"""
