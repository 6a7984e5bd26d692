"""Joint trajectories as in joint_trajectory_controller of ros2_controllers: sampling, rules, goals.

Pure state: no clock is read and nothing is sent. Times are integer nanoseconds, angles rad, lengths m.
"""
