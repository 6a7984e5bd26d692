"""A whole robot in virtual time: runtime, master, buses and virtual drives in one process under one clock.

Only this subpackage joins both sides of the wire: the same classes as `run` and `drive`, each with its own clock.
"""
