"""Device profiles other than CiA 402: the profile of a device, and its signals in units (I/O, sensors, batteries).

`profile_tables` returns all signals of a dictionary, `device_signal` describes one, `device_type` finds the profile of
a device. Nothing here does I/O.
"""
