"""Commissioning tools for a single node, on a bare bus or through a running robot."""
