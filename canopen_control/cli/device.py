"""Run virtual devices (I/O modules, encoders, sensors, batteries, drives) until Ctrl-C.

This is another name of the verb `drive`, with the same options; the EDS determines the kind of device. Set the inputs
of a running device with `fault`:

    canopen-control fault 5 di0=1,ai0=16384 --can local:robby

--status shows inputs and outputs of running devices. A device of CiA 401, 404, 406, 410, 418 or 419 has the signals of
its profile (the guide on devices lists them); with any other file it is a plain node that boots and answers.

Exit codes: 0 after Ctrl-C or SIGTERM; 1 the bus is gone, the node-ID is taken, or no device answers --status; 2 wrong
usage, or errors in files.
"""

from __future__ import annotations

from canopen_control.cli import drive

add_arguments, run = drive.add_arguments, drive.run

EXAMPLE = """canopen-control device --node-id 5 --eds generic_cia401.eds --can local:robby
         canopen-control device --node-id 5 --can local:robby --status"""
