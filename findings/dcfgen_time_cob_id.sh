#!/usr/bin/env bash
# dcfgen of dcf-tools 2.4.2 (PyPI, from the Lely CANopen stack) and `time_cob_id` of a device.
#
# Input: a network file of ros2_canopen's form, and a device whose 0x1012 (COB-ID of TIME) is 0x80000100 by default: bit
# 31 is set, it consumes TIME. `time_cob_id` is 0x100, which switches that off, and in a second file 0x80000100, which
# the device has already.
# Seen: the first is not written, the second is. The value is compared with 0x100, whatever the EDS of the device has.
# One would guess a write for the first and none for the second, as with `heartbeat_producer` and the other keys.
# Why it matters: the device goes on to set its clock by TIME, though the network file says otherwise; every other value
# of 0x1012 is written as expected, so that nobody looks for this one.
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
SupportedObjects=1
1=0x1012
[ManufacturerObjects]
SupportedObjects=0
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
variable("1012", 7, "rw", "0x80000100")
PYTHON

dcfgen() { # the files of the network whose device has the keys $1
    printf '%s\n' 'master: {node_id: 1}' "drive: {dcf: device.eds, node_id: 5, $1}" >bus.yml
    rm -f drive.bin
    venv/bin/python -W ignore venv/bin/dcfgen bus.yml || exit 1
}

written=""
for value in 0x100 0x80000100 0x80000101; do
    dcfgen "time_cob_id: $value"
    if [ -e drive.bin ]; then is=yes; else is=no; fi
    written="$written $value $is"
done
echo "dcfgen $(venv/bin/python -c 'import importlib.metadata as m; print(m.version("dcf-tools"))'):" \
    "0x1012 is 0x80000100 in the EDS; written:$written"
[ "$written" = " 0x100 no 0x80000100 yes 0x80000101 yes" ]
