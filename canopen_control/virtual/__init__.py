"""Virtual drives and devices: the device side of CANopen and its profiles, for any object dictionary.

From the outside in; a file imports those of its own line and of lines further down:

- a process of drives: `bus_group` (on several buses, in one world), `launch`, `process`
- devices: `device` (of an EDS), `scenario`, `control` (the socket), `node_host`
- their faults: `fault_table`
- their quirks: `quirks`, `power_quirks`, `motion_quirks`, `communication_quirks`, `quirk_base`
- what both do to frames and to the node: `fault_effects`
- a node: `virtual_node`, of `communication_objects`, `node_pdos`
- a device that is not a drive: `io_device`
- a drive: `virtual_drive`
- its modes of operation: `drive_modes`, `profile_modes`, `mode_base`
- what moves and stops an axis: `power_machine`, `axis_motion`
- what all share: `object_store`, `node_outbox`, `device_model`, `injection_point`
- what hangs on an axis: `plant_file`, `shaft`, `plant`, `trajectory` (motion over time)

Nothing is imported here: a drive's process starts in the time its own parts need.
"""
