"""Virtual drives and devices: the device side of CANopen and its profiles, for any object dictionary.

From the outside in; a file imports from its own line and from lines further down:

- a process of drives: `bus_group` (on several buses, in one world), `launch`, `process`
- devices: `device` (of an EDS), `scenario`, `control` (the socket), `node_host`
- faults: `fault_table`
- quirks: `quirks`, `power_quirks`, `motion_quirks`, `communication_quirks`, `quirk_base`
- effects of faults and quirks on frames and on the node: `fault_effects`
- a node: `virtual_node`, of `communication_objects`, `node_pdos`
- a device that is not a drive: `io_device`
- a drive: `virtual_drive`
- modes of operation: `drive_modes`, `profile_modes`, `mode_base`
- power and motion of an axis: `power_machine`, `axis_motion`
- used by all: `object_store`, `node_outbox`, `device_model`, `injection_point`
- mechanics of an axis: `plant_file`, `shaft`, `plant`, `trajectory` (motion over time)

Nothing is imported here, so that the process of a drive loads only the modules that it needs.
"""
