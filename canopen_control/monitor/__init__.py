"""Terminal monitor that shows a running robot, or a bare bus in listen-only mode, as tables."""
