"""Checks before a run: rules for a robot's files, stop times, and the record of a preflight."""
