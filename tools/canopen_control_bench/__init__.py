"""The bench: every figure as a ratio to a peer in the same run, or against a limit that is written beside it."""
