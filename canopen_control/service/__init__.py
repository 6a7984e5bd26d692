"""Service work on one node: its session, on a bare bus or through a running robot, and what is built on it."""
