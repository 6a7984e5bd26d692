"""CiA 301's services without I/O, a file each: NMT, error control, SDO, PDO, SYNC, EMCY, TIME, and CiA 305's LSS.

Every core has the same verbs: `receive(frame, now)` never raises on wire data, `tick(now)` and `next_deadline()`
serve its timers, `frames()` and `events()` drain what it wants sent and what happened. `now` is monotonic
nanoseconds. Nothing is imported here: whoever needs one service loads that one only.
"""
