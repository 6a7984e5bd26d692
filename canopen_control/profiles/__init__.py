"""Device profiles besides CiA 402: which one a device has, and its signals in units (I/O, sensors, batteries).

From the outside in: `profile_tables` (all signals of a dictionary), `io_tables`, `sensor_tables`, `error_modes` (what
outputs do when the master is gone), `device_type`, `device_signal`. Nothing here does any I/O.
"""
