"""CiA 402 (drives) without I/O: tables used by both sides of the bus, and the state machines of the master.

`state`, `modes`, `objects` and `units` are tables and arithmetic; `drive` is the master's side of an axis, `setpoint`
and `homing` are profile position and homing mode, `events` are the reports of all of them.
"""

from __future__ import annotations
