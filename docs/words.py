"""Meanings of the keys of bus.yml, for the generated reference.

The meanings of the controllers' parameters are the `help` texts of their settings, which ROS shows too. Type, default
and bounds come from the code. A test checks that every key has a text, and that every text has a key.
"""

from __future__ import annotations

_UNITS = {
    "scale_pos_to_dev": "device units per rad (m), for positions that are written",
    "scale_pos_from_dev": "rad (m) per device unit, for positions that are read",
    "scale_vel_to_dev": "device units per rad/s (m/s), for velocities that are written",
    "scale_vel_from_dev": "rad/s (m/s) per device unit, for velocities that are read",
    "scale_eff_from_dev": "Nm (N) per device unit, for torques that are read",
    "offset_pos_to_dev": "offset in device units, added to positions that are written",
    "offset_pos_from_dev": "offset in rad (m), added to positions that are read",
}

BUS_YML: dict[str, dict[str, str]] = {
    "`options`": {
        "dcf_path": "folder that is searched for EDS and DCF files first, before the folder of `bus.yml` and the "
        "bundled files",
        "heartbeat_multiplier": "number of heartbeat periods without a heartbeat after which a node counts as lost",
        "retry_factor": "life time factor of node guarding: number of unanswered requests after which a node counts as "
        "lost",
    },
    "`master`": {
        "node_id": "node-ID of the master, whose heartbeat the drives monitor",
        "channel": "channel of the bus (`can0`, `local:NAME`, ...); `--can` takes precedence",
        "baudrate": "bit rate in kbit/s, used by `check` for the bus load, and compared by the preflight",
        "sync_period": "period of SYNC in µs, which is the cycle of the robot; 0: no SYNC, the cycle is the "
        "`update_rate` of the controller manager",
        "sync_window": "time in µs for the synchronous PDOs; `check` reports PDOs that need longer",
        "sync_overflow": "largest value of the counter in SYNC, also written to the nodes (0x1019); 0: no counter",
        "sync_order": "`last`: SYNC follows the RPDOs of its cycle, and the drives apply them at once; `first`: SYNC "
        "begins the cycle, and its RPDOs have a whole period to arrive before the drives apply them. If another "
        "device sends SYNC, the cycle starts an eighth of a period after SYNC, or half a period with `last`. `auto`: "
        "`last` if the master sends SYNC, else `first`",
        "sync_producer": "sender of SYNC: `master`; `kernel` (on a SocketCAN interface, else the master); `other`, a "
        "node on the bus; `auto`: the kernel if a joint is commanded in CSP or CSV, its drive monitors the master, "
        "and `sync_order` is not `last`. The cycle follows a SYNC that the master does not send",
        "heartbeat_multiplier": "as in `options`, for the nodes of this bus",
        "heartbeat_producer": "heartbeat period of the master in ms; 0: 100",
        "boot_time": "time in ms in which required nodes must be running; 0: no limit",
        "boot_timeout": "timeout in ms of each SDO answer during a boot; absent: `sdo_timeout_ms` of the node",
    },
    "A node, and `defaults` of all": {
        "dcf": "EDS or DCF file of the device",
        "node_id": "node-ID of the device, 1 to 127",
        "dcf_path": "folder that is searched for the file first",
        "vendor_id": "vendor id that 0x1018:01 must contain; 0: any; absent: the vendor id of the EDS",
        "product_code": "product code that 0x1018:02 must contain; 0: any; absent: the product code of the EDS",
        "revision_number": "revision number that 0x1018:03 must contain; 0: any; absent: a difference from the EDS is "
        "reported",
        "serial_number": "serial number that 0x1018:04 must contain; 0: any",
        "heartbeat_multiplier": "as in `options`, for this node, and for the time after which the node reports the "
        "master as lost",
        "heartbeat_consumer": "whether the drive monitors the heartbeat of the master (0x1016) and stops when the "
        "heartbeat is lost; absent: if the drive can",
        "heartbeat_producer": "heartbeat period of the node in ms (0x1017); 0: 100, or node guarding",
        "guard_time": "time in ms between two guarding requests, for devices without a heartbeat",
        "life_time_factor": "number of unanswered guarding requests after which the node counts as lost",
        "retry_factor": "as in `options`",
        "error_behavior": "values of 0x1029 by subindex: what the device does when communication fails",
        "time_cob_id": "COB-ID of TIME, written to 0x1012",
        "rpdo": "RPDOs by number, 1 to 512",
        "tpdo": "TPDOs by number, 1 to 512",
        "sdo": "objects that the boot writes, in this order; the controlword of an axis is left out, with a warning",
        "boot": "false: the node is neither booted nor driven",
        "mandatory": "another name of `required`, from ros2_canopen",
        "required": "whether the robot needs the node to start; absent: the value of `mandatory`, else true. If "
        "`required` or `mandatory` is true, the loss of a node stops all axes even if the node moves nothing",
        "allow_unsupervised": "accept a drive that does not stop when the master is lost",
        "reset_communication": "false: a node that is running already is not reset",
        "software_version": "value that 0x1F56:01 must contain; 0: any",
        "configuration_file": "DCF or concise DCF (`.bin`) that is written before `sdo`; [which of two sources "
        "wins](../guide/ros2_canopen.md#which-of-two-sources-wins)",
        "restore_configuration": "subindex of 0x1011 that restores the defaults before the configuration; 0: none",
        "save_configuration": "subindex of 0x1010 that stores the parameters after a boot that changed some; 0: never",
        "sdo_timeout_ms": "timeout in ms of an SDO answer",
        "boot_timeout_ms": "timeout in ms of the boot-up message after a reset",
        "position_mode": "mode of operation for a position interface: 1 profile position, 7 interpolated, 8 cyclic",
        "velocity_mode": "mode of operation for a velocity interface: 2 velocity, 3 profile velocity, 9 cyclic",
        "effort_mode": "mode of operation for an effort interface: 4 profile torque, 10 cyclic",
        "position_target": "object for the target of `position_mode`, such as `0x607A` or `0x60F6:08`, for modes of "
        "the manufacturer (Technosoft -1 to -5, Kinco -3); an RPDO must contain the object",
        "velocity_target": "object for the target of `velocity_mode`",
        "effort_target": "object for the target of `effort_mode` (Kinco: `0x60F6:08`)",
        "motor_subindices": "subindices of axis 0 and axis 1, for a drive whose motors share a set of objects (ZLTECH "
        "ZLAC8015D); see [drives on the market](../guide/drive_makers.md)",
        "feed_forward": "objects that are mapped together with the target position: `velocity` 0x60B1, `effort` "
        "0x60B2; sent if the controller that commands the position in CSP commands these quantities too",
        "torque_mode": "another name of `effort_mode`",
        **_UNITS,
        "channels": "units of each axis of a device with several axes, in order; for missing keys the values of the "
        "node apply",
        "counts_per_revolution": "device units per turn of the motor, instead of the four scales",
        "gear_ratio": "motor turns per turn of the joint: a number, or [motor turns, joint turns]",
        "reversed": "whether the motor turns in the opposite direction of the joint",
        "guesses": "keys whose values have not been measured yet: written by `init`, reported by `check`",
        "homing_timeout_seconds": "timeout of homing in s",
        "recovery": "what happens when a lost node comes back: the node is booted, or also enabled again",
        "missed_syncs": "number of SYNCs without the TPDOs of the node after which its feedback is stale and the robot "
        "stops; on `local:` and vcan at least 0.25 s",
        "following_error_action": "reaction to bit 13 (following error) of the statusword; to a wheel or steering axis "
        "of a base that has not moved for 1.5 s although a motion is commanded; and to a position that does not change "
        "although the velocity shows a motion",
        "ignore_remote": "whether to ignore bit 9 (remote) of the statusword, for drives that never set the bit",
        "mode_timeout_ms": "timeout in ms until 0x6061 shows a requested mode; Festo CMMP-AS shows -1 for some seconds "
        "while it synchronises",
        "switching_state": "state in which the mode is changed: 2 SWITCH ON DISABLED, 3 READY TO SWITCH ON, 4 SWITCHED "
        "ON, 5 OPERATION ENABLED; for drives that change modes only while disabled: an enabled drive is taken down "
        "to this state at standstill, and enabled again afterwards",
        "fault_reset_timeout_ms": "timeout of a fault reset in ms, for drives that need longer",
        "enable_settle_ms": "time in ms after OPERATION ENABLED in which the targets do not change, for drives that "
        "accept set-points only when the brake is released (Elmo)",
        "transition_timeout_ms": "timeout in ms of a transition of CiA 402",
        "transition_timeouts_ms": "timeouts in ms of transitions of CiA 402, by number of the transition",
        "driver": "kind of the node on a bus without controllers: a drive if the name contains Cia402, a proxy for "
        "other names; absent: decided by the EDS; Lifecycle: with lifecycle services in ROS",
        "profile": "device profile (401 I/O, 402 drive, 404 measuring, 406 encoder, 410 inclinometer, 418 battery), if "
        "the EDS has a wrong profile; absent: a drive if the EDS has 0x6040 and 0x6041, else by 0x1000, else by the "
        "objects",
        "signals": "signals of the device in units, in addition to the signals of its profile, and before them",
        "namespace": "namespace of the topics and services of the node in ROS",
        "remappings": "remappings of the topics and services of the node in ROS",
        "channel_names": "names of the axes, for their services in ROS",
    },
    "One PDO": {
        "enabled": "whether the PDO exists (bit 31 of its COB-ID)",
        "cob_id": "COB-ID; `auto`: as in the predefined connection set; with bit 31 set, the PDO is off",
        "transmission": "transmission type: 1 to 240 at every n-th SYNC, 254 and 255 event-driven",
        "inhibit_time": "minimum time between two transmissions, in units of 100 µs",
        "event_timer": "time in ms after which an event-driven TPDO is sent again",
        "event_deadline": "another name of `event_timer`",
        "sync_start": "value of the SYNC counter at which the PDO starts",
        "mapping": "mapped objects, in order",
    },
    "A mapped object": {
        "index": "index of the object",
        "sub_index": "subindex of the object",
        "bits": "length in bits; only compared with the length in the EDS, which applies",
    },
    "An object of `sdo`": {
        "index": "index of the object",
        "sub_index": "subindex of the object",
        "value": "a number, a text, hex digits for bytes, or `save` and `load` for 0x1010 and 0x1011",
    },
    "The units of one axis": _UNITS,
    "A signal": {
        "name": "name of the interface; a name of the profile (`di0`, `ai1`, `position`) changes that signal",
        "object": 'object of the signal, 0x6401 or "0x6401:01", or one bit of an object, "0x6000:01.3"',
        "type": "data type of the object, if the EDS has a wrong type",
        "factor": "units per raw number, instead of the scale that the device has",
        "offset": "offset in units, added to the value",
        "unit": "name of the unit, only for display",
        "invalid": "raw numbers that mean no value, and are shown as nan",
        "max_rate": "largest change of an input in units per second: a faster change is reported as a jump, and the "
        "value is nan until the next boot of the node",
        "safe": "value of an output when the master is lost (0x6207 and similar objects), or `keep`; absent: 0",
    },
}
