"""Pytest plug-in: robots in virtual time, fault injection in drives and buses, and access to motor shafts."""
