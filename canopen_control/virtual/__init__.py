"""Virtual drives and devices: the device's side of CANopen and its profiles, on any object dictionary.

From the outside in; a file imports those of its own line and of lines further down:

- a process of drives: `bus_group` (on several buses, in one world), `launch`, `node_id_check`, `process`, `served_bus`
- devices: `device` (of an EDS), `parameter_file`, `scenario`, `world_acts` (of it), `control` (the socket),
  `nodehost`
- their faults: `fault_switches`, `fault_table`, `device_faults`, `fault_actions` (on frames)
- a node: `virtual_node`, of `frame_routes`, `communication_objects`, `node_pdos`, `mapped_pdo`, `pdo_records`,
  `rpdo_input`, `error_control`, `node_lss`, `program_area`
- a device that is no drive: `device_function`, `position_devices`, `sensor_device`, `io_device`,
  `input_faults`
- a drive: `virtual_drive`, of `drive_modes`, `axis_readings`, `touch_probes`, `overload`
- its modes of operation: `profile_modes`, `interpolated_mode`, `cyclic_modes`, `set_point_stream`, `homing_mode`,
  `mode_base`
- what moves and stops an axis, and how evenly: `axis_limits`, `power_machine`, `mover`, `switches`, `set_point_meter`
- what all share: `object_store`, `node_outbox`, `node_events`, `axis_objects`, `device_model`, `tmcm1270`,
  `fault_seam`, `sync_rhythm`
- what hangs on an axis: `worldfile`, `shaft`, `diffbase`, `wheel`, `velocity_loop`, `plant`, `trajectory` (motion over
  time)

Nothing is imported here: a drive's process starts in the time its own parts need.
"""
