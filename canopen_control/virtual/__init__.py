"""Virtual drives: the device's side of CANopen and CiA 402, on any object dictionary.

Nothing is imported here: a drive's process starts in the time its own parts need.
"""
