"""Commissioning tools for a single node, which is reached on a bare bus or through a running robot."""
