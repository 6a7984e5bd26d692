"""The bench: each figure is a ratio to a comparable package in the same run, or is compared with a limit."""
