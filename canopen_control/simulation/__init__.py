"""Simulation of a whole robot in virtual time: runtime, master, buses and virtual drives in one process.

Only this subpackage uses both sides of the bus: the classes of `run` and those of `drive`, with a clock for each
process.
"""
