"""Terminal monitor: a running robot, or a bare bus in listening mode, as tables."""
