"""CiA 402 (drives) without I/O: tables for both sides of the bus, and state machines of the master.

`state`, `modes`, `objects`, `motors`, `loop_gains` and `units` are tables and arithmetic; `drive` with `drive_goal` is
the master's side of an axis, `setpoint` and `homing` implement profile position and homing mode, and `events` are the
reports of the drive's state machine.
"""

from __future__ import annotations
