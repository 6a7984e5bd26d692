"""What each key of bus.yml means: the words of the generated reference.

Those of the controllers' parameters are the `help` of their settings, which ROS describes them by as well.
Type, default and bounds come from the code. A test holds that every key has its words, and that no words are left over.
"""

from __future__ import annotations

_UNITS = {
    "scale_pos_to_dev": "device units per rad (m), of positions that are written",
    "scale_pos_from_dev": "rad (m) per device unit, of positions that are read",
    "scale_vel_to_dev": "device units per rad/s (m/s), of velocities that are written",
    "scale_vel_from_dev": "rad/s (m/s) per device unit, of velocities that are read",
    "scale_eff_from_dev": "Nm (N) per device unit, of torques that are read",
    "offset_pos_to_dev": "device units that are added to a position that is written",
    "offset_pos_from_dev": "rad (m) that are added to a position that is read",
}

BUS_YML: dict[str, dict[str, str]] = {
    "`options`": {
        "dcf_path": "where EDS and DCF files are sought, before the folder of the file and the bundled ones",
        "heartbeat_multiplier": "after how many heartbeat periods of silence a node counts as lost",
        "retry_factor": "the same for node guarding: its life time factor",
    },
    "`master`": {
        "node_id": "the master's own node id, whose heartbeat the drives watch",
        "channel": "where the bus is (`can0`, `local:NAME`, ...); `--can` goes before it",
        "baudrate": "kbit/s: what `check` counts the budget with, and the pre-flight compares",
        "sync_period": "us between two SYNCs, the cycle of the robot; 0: no SYNC, the controller manager's update_rate",
        "sync_window": "us that the synchronous PDOs may take; `check` says where they take longer",
        "sync_overflow": "the SYNC carries a counter up to this; written to the nodes (0x1019) too; 0: none",
        "sync_order": "`last`: SYNC follows the RPDOs of its cycle, and drives act on them at once; `first`: SYNC "
        "begins the cycle, and its RPDOs have a whole period to arrive, which is when drives act on them. A cycle that "
        "follows another's SYNC comes an eighth of a period after it, with `last` half a one. `auto`: `last` for a "
        "SYNC of the master, `first` for that of others",
        "sync_producer": "sender of SYNC: the `master`; the `kernel`, where the channel is a SocketCAN interface, else "
        "the master; `other`, a node of the bus; `auto`: the kernel where a joint is commanded in CSP or CSV, its "
        "drive watches the master, and `sync_order` is not `last`. The cycle follows the SYNC of others",
        "heartbeat_multiplier": "as in `options`, for the nodes of this bus",
        "heartbeat_producer": "ms between two heartbeats of the master; 0: 100",
        "boot_time": "ms that required nodes may take until they run; 0: for ever",
        "boot_timeout": "ms for each SDO answer during a boot; else `sdo_timeout_ms` of the node",
    },
    "A node, and `defaults` of all": {
        "dcf": "the EDS or DCF file of the device",
        "node_id": "its node id, 1 to 127",
        "dcf_path": "where its file is sought first",
        "vendor_id": "the vendor that 0x1018:01 must show; 0: any; absent: that of the EDS",
        "product_code": "the product that 0x1018:02 must show; 0: any; absent: that of the EDS",
        "revision_number": "the revision that 0x1018:03 must show; 0: any; absent: a difference to the EDS is reported",
        "serial_number": "the serial number that 0x1018:04 must show; 0: any",
        "heartbeat_multiplier": "as in `options`, for this node and for what it grants the master",
        "heartbeat_consumer": "the drive watches the master (0x1016) and stops without it; absent: where it can",
        "heartbeat_producer": "ms between two of its heartbeats (0x1017); 0: 100, or guarding",
        "guard_time": "ms between two guarding requests, for devices without a heartbeat",
        "life_time_factor": "after how many unanswered guarding requests the node counts as lost",
        "retry_factor": "as in `options`",
        "error_behavior": "sub-index to value of 0x1029: what the device does when communication fails",
        "time_cob_id": "the COB-ID of TIME, written to 0x1012",
        "rpdo": "the RPDOs by number, 1 to 512",
        "tpdo": "the TPDOs by number, 1 to 512",
        "sdo": "objects that the boot writes, in their order",
        "boot": "false: the node is not booted, nor driven",
        "mandatory": "ros2_canopen's word for `required`",
        "required": "the robot does not start without the node; absent: what `mandatory` says, else true. Where one "
        "of them says true, the loss of a node that moves nothing stops all axes",
        "allow_unsupervised": "accepts a drive that nothing would stop when the master is lost",
        "reset_communication": "false: a node that runs already is kept alive instead of being reset",
        "software_version": "what 0x1F56:01 must show; 0: anything",
        "configuration_file": "a DCF or concise DCF (`.bin`) that is written before `sdo`; "
        "[which of two sources wins](../guide/ros2_canopen.md#which-of-two-sources-wins)",
        "restore_configuration": "sub-index of 0x1011 to restore defaults with, before the configuration; 0: none",
        "save_configuration": "sub-index of 0x1010 to store with, after a boot that changed something; 0: never",
        "sdo_timeout_ms": "ms that an SDO server may take for an answer",
        "boot_timeout_ms": "ms until the boot-up message after a reset",
        "position_mode": "mode of operation for a position interface: 1 profile position, 7 interpolated, 8 cyclic",
        "velocity_mode": "for a velocity interface: 2 velocity, 3 profile velocity, 9 cyclic",
        "effort_mode": "for an effort interface: 4 profile torque, 10 cyclic",
        "position_target": "the object that takes the target of `position_mode`, such as `0x607A` or `0x60F6:08`, for "
        "the manufacturer's modes (Technosoft -1 to -5, Kinco -3) and objects; an RPDO has to carry it",
        "velocity_target": "the same for `velocity_mode`",
        "effort_target": "the same for `effort_mode` (Kinco: `0x60F6:08`)",
        "motor_subindices": "of a drive whose motors share one set of objects (ZLTECH ZLAC8015D): the subindex of axis "
        "0, of axis 1; see [drives of makers](../guide/drive_makers.md)",
        "feed_forward": "objects mapped with the target position: `velocity` 0x60B1, `effort` 0x60B2; sent where the "
        "controller of a position in CSP commands it too",
        "torque_mode": "another word for `effort_mode`",
        **_UNITS,
        "channels": "the units of each axis of a device with several, in their order; what is absent is the node's",
        "counts_per_revolution": "device units per turn of the motor: instead of the four scales",
        "gear_ratio": "motor turns per turn of the joint, a number or [motor turns, joint turns]",
        "reversed": "the motor turns against the joint",
        "guesses": "the keys whose values have not been measured yet: `init` writes it, `check` names them",
        "homing_timeout_seconds": "s that homing may take",
        "recovery": "how far a node that comes back goes by itself: booted, or enabled again too",
        "missed_syncs": "SYNCs without its TPDOs until its feedback is stale and the robot stops; on `local:` and "
        "vcan not before 0.25 s",
        "following_error_action": "what bit 13 of the statusword leads to",
        "ignore_remote": "bit 9 (remote) of the statusword does not count, for drives that never set it",
        "mode_timeout_ms": "ms until 0x6061 shows a mode that was asked for; Festo CMMP-AS shows -1 for some seconds "
        "while it synchronises",
        "switching_state": "state in which the mode changes: 2 SWITCH ON DISABLED, 3 READY TO SWITCH ON, "
        "4 SWITCHED ON, 5 OPERATION ENABLED; an enabled drive goes down to it for a new mode, once it stands, and "
        "comes back, for drives that change their mode only while they are disabled",
        "fault_reset_timeout_ms": "ms until a fault that was reset has to be gone, for drives that take longer",
        "enable_settle_ms": "ms after OPERATION ENABLED in which the targets rest, for drives whose set-points count "
        "only when the brake has lifted (Elmo)",
        "transition_timeout_ms": "ms that the drive may take for a transition of CiA 402",
        "transition_timeouts_ms": "the same by the transition's number",
        "driver": "what the node is on a bus without controllers: a drive where it says Cia402, a proxy where it says "
        "anything else, by the EDS where it says nothing; Lifecycle: with lifecycle services in ROS",
        "profile": "the device profile (401 I/O, 402 drive, 404 measuring, 406 encoder, 410 inclinometer, 418 battery) "
        "where its file says a wrong one; absent: a drive has 0x6040 and 0x6041, else 0x1000 says it, else the objects",
        "signals": "signals of the device in units, in addition to those of its profile, and before them",
        "namespace": "of its topics and services in ROS",
        "remappings": "of its topics and services in ROS",
        "channel_names": "names of the axes, for the services of each in ROS",
    },
    "One PDO": {
        "enabled": "whether the PDO exists (bit 31 of its COB-ID)",
        "cob_id": "its COB-ID; `auto`: that of the predefined connection set; with bit 31 the PDO is off",
        "transmission": "transmission type: 1 to 240 with every n-th SYNC, 254 and 255 by events",
        "inhibit_time": "least time between two, in 100 us",
        "event_timer": "ms after which an event-driven TPDO is sent again",
        "event_deadline": "another word for `event_timer`",
        "sync_start": "the count of SYNC at which it begins",
        "mapping": "the mapped objects, in their order",
    },
    "A mapped object": {
        "index": "index of the object",
        "sub_index": "its sub-index",
        "bits": "length; compared with the EDS, whose length counts",
    },
    "An object of `sdo`": {
        "index": "index of the object",
        "sub_index": "its sub-index",
        "value": "a number, text, hex digits for bytes, or `save` and `load` for 0x1010 and 0x1011",
    },
    "The units of one axis": _UNITS,
    "A signal": {
        "name": "of the interface; a name of the profile (`di0`, `ai1`, `position`) changes that signal",
        "object": 'its object, 0x6401 or "0x6401:01", or a bit of one, "0x6000:01.3"',
        "type": "what the bits of the object are taken for, where its file says a wrong type",
        "factor": "units per raw number; instead of what the device says of its scale",
        "offset": "units that are added",
        "unit": "the name of the unit, for people",
        "invalid": "raw numbers that stand for no value, and are shown as nan",
        "max_rate": "units per second that an input can change by: a faster change is a jump, is reported, and is nan "
        "until the node's next boot",
        "safe": "of an output: its value when the master is gone (0x6207 and its like), or `keep`; absent: 0",
    },
}
