"""CiA 402, the profile of drives, sans-IO: tables that both ends of the bus share, and the master's machines.

`state`, `modes`, `options`, `objects` and `units` are tables and arithmetic; `drive` is the master's side of an axis,
`setpoint` and `homing` what it does in profile position and homing mode, `events` what they report.
"""

from __future__ import annotations
