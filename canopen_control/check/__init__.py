"""Checks before a run: a robot's files and the rules between them, stop times, and the record of a preflight."""
