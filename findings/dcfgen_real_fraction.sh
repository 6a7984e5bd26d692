#!/usr/bin/env bash
# dcfgen of dcf-tools 2.4.2 (PyPI, from the Lely CANopen stack) and an `sdo:` value of a REAL32 object.
#
# Input: a network file of ros2_canopen's form. A device has a gain in 0x2003, REAL32, and `sdo:` gives it 0.5.
# Seen: the concise DCF of the device writes 0.0; with 1.5 it writes 1.0. The value becomes an integer before it is
# encoded, without a warning.
# One would guess 0.5, whose bits are 0x3F000000, or an error that numbers with a fraction are not possible.
# Why it matters: the master writes the file at each boot. A gain or a factor of 0 replaces the good value in the
# drive, and what the network file says looks right.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && python3 -m venv venv || exit 2
venv/bin/pip install -q dcf-tools==2.4.2 empy==4.2.1 setuptools==80.9.0 2>/dev/null || exit 2

python3 - >device.eds <<'PYTHON'
print("""[FileInfo]
FileName=device.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0
[DeviceInfo]
VendorName=v
VendorNumber=1
ProductName=p
ProductNumber=1
RevisionNumber=1
BaudRate_500=1
Granularity=8
NrOfRXPDO=0
NrOfTXPDO=0
[DummyUsage]
Dummy0005=0
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018
[OptionalObjects]
SupportedObjects=0
[ManufacturerObjects]
SupportedObjects=1
1=0x2003
""")


def record(index: str, name: str, entries: int) -> None:
    print(f"[{index}]\nParameterName={name}\nObjectType=0x9\nSubNumber={entries}")


def variable(section: str, data_type: int, access: str, default: object, mappable: int = 0) -> None:
    print(f"[{section}]\nParameterName={section}\nObjectType=0x7\nDataType=0x{data_type:04X}")
    print(f"AccessType={access}\nDefaultValue={default}\nPDOMapping={mappable}")


variable("1000", 7, "ro", 0)
variable("1001", 5, "ro", 0)
record("1018", "Identity", 5)
for subindex, value in enumerate((4, 1, 1, 1, 1)):
    variable(f"1018sub{subindex}", 7 if subindex else 5, "ro", value)
variable("2003", 8, "rw", "0x3F800000")
PYTHON

dcfgen() { # the files of the network whose device has the keys $1
    printf '%s\n' 'master: {node_id: 1}' "drive: {dcf: device.eds, node_id: 5, $1}" >bus.yml
    rm -f drive.bin
    venv/bin/python -W ignore venv/bin/dcfgen bus.yml || exit 1
}

written=""
for value in 0.5 1.5; do
    dcfgen "sdo: [{index: 0x2003, value: $value}]"
    written="$written $(tail -c 4 drive.bin | od -An -tx4 --endian=little | tr -d ' ')"
done
echo "dcfgen $(venv/bin/python -c 'import importlib.metadata as m; print(m.version("dcf-tools"))'):" \
    "REAL32 with 0.5 and 1.5 in the network file, written as$written"
[ "$written" = " 00000000 3f800000" ]
