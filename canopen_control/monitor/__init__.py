"""Terminal monitor: shows a running robot, or a bare bus in listen-only mode, as tables."""
