"""Summarise an EDS and list its issues: `python eds_issues.py FILE [NODE_ID]`."""

import sys

from canopen_control import read_eds
from canopen_control.errors import EdsError

try:
    eds = read_eds(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else None)
except EdsError as error:  # not a CANopen EDS at all; any other issue is tolerated
    sys.exit(str(error))

device = eds.od.device
print(f"{device.vendor_name} {device.product_name}: {len(list(eds.od))} entries")
for index, subindex in ((0x1000, 0), (0x6041, 0), (0x6060, 0), (0x60FF, 0)):
    entry = eds.od.get(index, subindex)
    if entry is not None:
        print(f"0x{index:04X}:{subindex:02X} {entry.name}: {entry.data_type.name}, default {entry.default!r}")
for issue in eds.issues:
    print(issue)
