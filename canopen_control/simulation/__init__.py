"""A whole robot in virtual time: runtime, master, buses and virtual drives in one process under one clock.

The only room that joins both sides of the wire: the same classes as `run` and `drive`, each part with a clock of its
own.
"""
