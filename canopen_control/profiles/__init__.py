"""Device profiles besides CiA 402: which one a device has, and its signals in units (I/O, sensors, batteries).

`profile_tables` has all signals of a dictionary, `device_signal` one of them, `device_type` the profile of a device.
Nothing here does any I/O.
"""
