"""Plug-in for pytest: robots in virtual time, with faults of drives and buses and access to their shafts."""
