"""CiA 301 services without I/O: NMT, error control, SDO, PDO, SYNC, TIME and EMCY; and LSS of CiA 305.

All cores share one interface: `receive(frame, now)` never raises on data from the bus; `tick(now)` and
`next_deadline()` operate the timers; `frames()` and `events()` return and clear the frames to send and the events that
occurred. `now` is monotonic time in ns. Nothing is imported here, so that a program loads only the services it uses.
"""
