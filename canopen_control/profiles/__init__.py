"""Device profiles other than CiA 402: the profile of a device, and its signals in units (I/O, sensors, batteries).

`profile_tables` lists the signals of a dictionary, `device_signal` defines a signal, `device_type` determines the
profile of a device. Nothing here does I/O.
"""
