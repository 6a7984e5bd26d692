"""The terminal monitor: a running robot, or a bare bus that it only listens to, as tables in a terminal."""
