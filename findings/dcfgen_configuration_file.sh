#!/usr/bin/env bash
# dcfgen of dcf-tools 2.4.2 (PyPI, from the Lely CANopen stack) and the key `configuration_file`.
#
# Input: a network file of ros2_canopen's form, whose documentation has `configuration_file`: "the name of the file
# containing the configuration (default: "<dcf_path>/<name>.bin", see object 1F22)". A device has `configuration_file:
# commissioned.bin`, once alone, and once with an `sdo:` list.
# Seen: no file that is made names commissioned.bin. Alone, the master has no 0x1F22 entry for the device; with the
# list the entry is drive.bin, the default.
# One would guess commissioned.bin in 0x1F22 of the master's DCF.
# Why it matters: a device that was commissioned with a file of its own boots without it, or with the list only, and
# the master reports a successful boot.
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
1=0x2001
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
variable("2001", 6, "rw", 0)
PYTHON

dcfgen() { # the files of the network whose device has the keys $1
    printf '%s\n' 'master: {node_id: 1}' "drive: {dcf: device.eds, node_id: 5, $1}" >bus.yml
    rm -f drive.bin
    venv/bin/python -W ignore venv/bin/dcfgen bus.yml || exit 1
}

entries() { # the file in 0x1F22 of the master, for the device with the keys $1
    dcfgen "$1"
    if grep -rqa commissioned master.dcf ./*.bin; then exit 1; fi
    grep -oaE 'drive\.bin' master.dcf | head -1
}

alone=$(entries 'configuration_file: commissioned.bin')
listed=$(entries 'configuration_file: commissioned.bin, sdo: [{index: 0x2001, value: 3}]')
echo "dcfgen $(venv/bin/python -c 'import importlib.metadata as m; print(m.version("dcf-tools"))'):" \
    "configuration_file: commissioned.bin; in 0x1F22 of the master: ${alone:-none}, with an sdo list ${listed:-none}"
[ -z "$alone" ] && [ "$listed" = drive.bin ]
