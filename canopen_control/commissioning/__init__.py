"""Commissioning of one node: its session on a bare bus or through a running robot, and the tools that use it."""
