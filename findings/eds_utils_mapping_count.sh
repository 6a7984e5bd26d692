#!/usr/bin/env bash
# eds-utils 0.3.1 (PyPI) and the number of mapped objects in an EDS.
#
# Input: an EDS whose RPDO 1 has room for two objects and one in use: 0x1600:00 is rw with DefaultValue=1, 0x1600:01
# holds 0x20010010 and 0x1600:02 has no value. The file is read and written again, as eds2dcf does.
# Seen: in the file that is written 0x1600:00 is "const" with DefaultValue=0x02, and 0x1600:02 is 0x00000000. The list
# of changes names the second, and is silent about the first.
# One would guess the same access and the same number: CiA 301 has subindex 0 of a mapping count the objects in use,
# and a client changes a mapping by writing it.
# Why it matters: a master that configures PDOs from the new file believes that the mapping cannot be written, or maps
# two objects of which one is none; a device generated from it refuses each new mapping.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q eds-utils==0.3.1 2>/dev/null || exit 2
cd "$folder" || exit 2

python3 - >device.eds <<'PYTHON'
head = """[FileInfo]
FileName=device.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0
Description=one RPDO
CreationTime=09:00AM
CreationDate=01-02-2025
CreatedBy=a
ModificationTime=09:00AM
ModificationDate=01-02-2025
ModifiedBy=a

[DeviceInfo]
VendorName=v
VendorNumber=1
ProductName=p
ProductNumber=1
RevisionNumber=1
OrderCode=p
BaudRate_10=0
BaudRate_20=0
BaudRate_50=0
BaudRate_125=0
BaudRate_250=0
BaudRate_500=1
BaudRate_800=0
BaudRate_1000=1
SimpleBootUpMaster=0
SimpleBootUpSlave=1
Granularity=8
DynamicChannelsSupported=0
GroupMessaging=0
NrOfRXPDO=1
NrOfTXPDO=0
LSS_Supported=0

[DummyUsage]
Dummy0001=0
Dummy0002=0
Dummy0003=0
Dummy0004=0
Dummy0005=1
Dummy0006=0
Dummy0007=0

[Comments]
Lines=0

[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018

[OptionalObjects]
SupportedObjects=2
1=0x1400
2=0x1600

[ManufacturerObjects]
SupportedObjects=1
1=0x2001
"""
print(head)


def variable(section: str, name: str, data_type: int, access: str, default: str, mappable: int = 0) -> None:
    print(f"[{section}]\nParameterName={name}\nObjectType=0x7\nDataType=0x{data_type:04X}\nAccessType={access}")
    print(f"DefaultValue={default}\nPDOMapping={mappable}\n")


def record(index: str, name: str, entries: int) -> None:
    print(f"[{index}]\nParameterName={name}\nObjectType=0x9\nSubNumber={entries}\n")


variable("1000", "Device type", 7, "ro", "0")
variable("1001", "Error register", 5, "ro", "0")
record("1018", "Identity", 5)
for subindex, value in enumerate((4, 1, 1, 1, 1)):
    variable(f"1018sub{subindex}", f"identity {subindex}", 7 if subindex else 5, "ro", str(value))
record("1400", "RPDO 1", 3)
variable("1400sub0", "highest subindex", 5, "ro", "2")
variable("1400sub1", "COB-ID", 7, "rw", "$NODEID+0x200")
variable("1400sub2", "transmission type", 5, "rw", "255")
record("1600", "mapping of RPDO 1", 3)
variable("1600sub0", "number of mapped objects", 5, "rw", "1")
variable("1600sub1", "object 1", 7, "rw", "0x20010010")
variable("1600sub2", "object 2", 7, "rw", "")
variable("2001", "speed", 3, "rw", "0", 1)
PYTHON
venv/bin/python - <<'PYTHON'
import configparser
import importlib.metadata
import sys

from eds_utils.core.file_io.read_eds import read_eds
from eds_utils.core.file_io.write_eds import write_eds

eds, changes = read_eds("device.eds")
write_eds(eds, file_path="written.eds")
files = []
for name in ("device.eds", "written.eds"):
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.read(name)
    section = parser["1600sub0"]
    files.append((section["AccessType"], int(section["DefaultValue"], 0)))
print(f"eds-utils {importlib.metadata.version('eds-utils')}: 0x1600:00 before {files[0]}, after {files[1]}; changes: {changes}")
sys.exit(files != [("rw", 1), ("const", 2)] or any("subindex 0x00" in change for change in changes))
PYTHON
