#!/usr/bin/env bash
# dcfgen of dcf-tools 2.4.2 (PyPI, from the Lely CANopen stack) and a PDO with `enabled: false`.
#
# Input: a network file of ros2_canopen's form. A device has an RPDO and a TPDO, valid by default, on 0x205 and 0x185;
# both are switched off by `enabled: false`.
# Seen: the device is told to disable both: bit 31 of 0x1400:01 and 0x1800:01 is written. In the DCF of the master both
# remain: 0x1800:01 is 0x205, valid, with one mapped object, and 0x1400:01 is 0x185, valid, with one.
# One would guess a master without these two PDOs, as with `cob_id: 0x80000205` and `cob_id: 0x80000185`.
# Why it matters: the master sends 0x205 at each SYNC to nobody. If the COB-ID of the PDO that is off is given to
# another PDO, the master has two with one COB-ID, and stores what it receives in the wrong objects.
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
NrOfRXPDO=1
NrOfTXPDO=1
[DummyUsage]
Dummy0005=0
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018
[OptionalObjects]
SupportedObjects=4
1=0x1400
2=0x1600
3=0x1800
4=0x1A00
[ManufacturerObjects]
SupportedObjects=2
1=0x2001
2=0x2002
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
for communication, mapping, cob_id, value in (
    ("1400", "1600", 0x200, 0x20010010),
    ("1800", "1A00", 0x180, 0x20020010),
):
    record(communication, "communication", 5)
    variable(f"{communication}sub0", 5, "ro", 5)
    variable(f"{communication}sub1", 7, "rw", f"$NODEID+0x{cob_id:X}")
    variable(f"{communication}sub2", 5, "rw", 1)
    variable(f"{communication}sub3", 6, "rw", 0)
    variable(f"{communication}sub5", 6, "rw", 0)
    record(mapping, "mapping", 2)
    variable(f"{mapping}sub0", 5, "rw", 1)
    variable(f"{mapping}sub1", 7, "rw", f"0x{value:08X}")
variable("2001", 6, "rww", 0, 1)
variable("2002", 6, "ro", 0, 1)
PYTHON

dcfgen() { # the files of the network whose device has the keys $1
    printf '%s\n' 'master: {node_id: 1}' "drive: {dcf: device.eds, node_id: 5, $1}" >bus.yml
    rm -f drive.bin
    venv/bin/python -W ignore venv/bin/dcfgen bus.yml || exit 1
}

valid() { # the COB-IDs of the valid PDOs in the DCF of the master; $1 and $2 are the keys of the RPDO and the TPDO
    dcfgen "rpdo: {1: {$1}}, tpdo: {1: {$2}}"
    awk -F= '/^\[/ { pdo = /^\[(14|18)00sub1\]/ } pdo && /^DefaultValue/ { print $2 }' master.dcf | tr '\n' ' '
}

off=$(valid 'enabled: false' 'enabled: false')
told=$(od -An -tx4 --endian=little -v -j11 -N4 drive.bin | tr -d ' ')
invalid=$(valid 'cob_id: 0x80000205' 'cob_id: 0x80000185')
echo "dcfgen $(venv/bin/python -c 'import importlib.metadata as m; print(m.version("dcf-tools"))'):" \
    "enabled: false: 0x1400:01 of the device 0x$told, PDOs of the master $off; invalid COB-IDs: ${invalid:-none}"
[ "$off" = "0x00000185 0x00000205 " ] && [ "$told" = 80000205 ] && [ -z "$invalid" ]
