#!/usr/bin/env bash
# canviz 0.3.1 (PyPI) and the EDS of a drive.
# (Its decoder needs canopen only; the package is installed without its web server.)
#
# Input: an EDS whose TPDO 1 maps 0x6041 (statusword, UNSIGNED16) and 0x606C (velocity actual value, INTEGER32), and one
# such PDO: OPERATION ENABLED, -100. It is decoded twice, without an EDS and with it.
# Seen: without, the state is "Operation Enabled". With the EDS there is no state, the objects have no names
# ("0x6041:0"), and the velocity is 4294967196.0.
# One would guess more with the file than without: names, -100, and the same state.
# Why it matters: the file is loaded to see more. A motor that turns backwards slowly looks like one that runs away, and
# the state of the drive is gone at the moment the file is there.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen==2.4.1 2>/dev/null || exit 2
"$folder/venv/bin/pip" install -q --no-deps canviz==0.3.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

from canviz.canopen_store import canopen_store, eds_store


def variable(section: str, name: str, data_type: int, default: str, mappable: int = 0) -> str:
    return f"""[{section}]
ParameterName={name}
ObjectType=0x7
DataType=0x{data_type:04X}
AccessType=rw
DefaultValue={default}
PDOMapping={mappable}
"""


def record(index: str, name: str, subindices: list[tuple[str, int, str]]) -> str:
    head = f"[{index}]\nParameterName={name}\nObjectType=0x9\nSubNumber={len(subindices)}\n"
    return head + "".join(variable(f"{index}sub{number}", *rest) for number, rest in enumerate(subindices))


eds = (
    "[DeviceInfo]\nVendorName=v\nProductName=p\n[MandatoryObjects]\nSupportedObjects=0\n[OptionalObjects]\nSupportedObjects=4\n"
    "1=0x1800\n2=0x1A00\n3=0x6041\n4=0x606C\n"
    + record("1800", "TPDO 1", [("Count", 5, "2"), ("COB-ID", 7, "$NODEID+0x180"), ("Type", 5, "1")])
    + record("1A00", "Mapping 1", [("Count", 5, "2"), ("Object 1", 7, "0x60410010"), ("Object 2", 7, "0x606C0020")])
    + variable("6041", "Statusword", 6, "0", 1)
    + variable("606C", "Velocity actual value", 4, "0", 1)
)
pdo = (0x0237).to_bytes(2, "little") + (-100).to_bytes(4, "little", signed=True)
canopen_store.set_mode("on")
without = canopen_store.process_frame(0x181, pdo, False).get("cia402_state_default")
assert eds_store.load(eds.encode(), "drive.eds")["ok"]
frame = canopen_store.process_frame(0x181, pdo, False)
signals = [(signal["name"], signal["value"]) for signal in frame["pdo_signals"]]
state = frame.get("cia402_state", frame.get("cia402_state_default"))
print(f"canviz {importlib.metadata.version('canviz')}: state without the EDS: {without}; with it: {state}, {signals}")
sys.exit((without, state, signals[1]) != ("Operation Enabled", None, ("0x606C:0", 4294967196.0)))
PYTHON
