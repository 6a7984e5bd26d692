#!/usr/bin/env bash
# eds-utils 0.3.1 (PyPI) and the serial number in a DCF.
#
# Input: a DCF of node 5 at 500 kbit/s, with LSS_SerialNumber=123456 in [DeviceComissioning]. The file is read, and
# written again as a DCF.
# Seen: in the file that is written LSS_SerialNumber is 1; of 0 it makes 0. The list of changes does not name it; node
# id and bit rate are right.
# One would guess 123456: CiA 306 has the serial number of the device there, for LSS.
# Why it matters: a configuration tool finds the device for its node id by the serial number (LSS switch mode
# selective), and finds none; a master that checks the identity at boot refuses the right device.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q eds-utils==0.3.1 2>/dev/null || exit 2
cd "$folder" || exit 2

cat >device.dcf <<'DCF'
[FileInfo]
FileName=device.dcf
FileVersion=1
FileRevision=1
EDSVersion=4.0
Description=a device with its serial number
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
BaudRate_1000=0
SimpleBootUpMaster=0
SimpleBootUpSlave=1
Granularity=0
DynamicChannelsSupported=0
GroupMessaging=0
NrOfRXPDO=0
NrOfTXPDO=0
LSS_Supported=1

[DummyUsage]
Dummy0001=0
Dummy0002=0
Dummy0003=0
Dummy0004=0
Dummy0005=0
Dummy0006=0
Dummy0007=0

[Comments]
Lines=0

[DeviceComissioning]
NodeID=5
NodeName=left
Baudrate=500
NetNumber=1
NetworkName=net
CANopenManager=0
LSS_SerialNumber=123456

[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018

[OptionalObjects]
SupportedObjects=0

[ManufacturerObjects]
SupportedObjects=0

[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0
PDOMapping=0

[1001]
ParameterName=Error register
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=0
PDOMapping=0

[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2

[1018sub0]
ParameterName=Highest sub-index supported
ObjectType=0x7
DataType=0x0005
AccessType=const
DefaultValue=1
PDOMapping=0

[1018sub1]
ParameterName=Vendor-ID
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=1
PDOMapping=0

DCF
venv/bin/python - <<'PYTHON'
import configparser
import importlib.metadata
import sys

from eds_utils.core.file_io.read_eds import read_eds
from eds_utils.core.file_io.write_eds import write_eds

device, changes = read_eds("device.dcf")
write_eds(device, file_path="written.dcf", dcf=True)
parser = configparser.ConfigParser(strict=False, interpolation=None)
parser.read("written.dcf")
section = parser["DeviceComissioning"]
seen = [section["NodeID"], section["Baudrate"], section["LSS_SerialNumber"]]
version = importlib.metadata.version("eds-utils")
print(f"eds-utils {version}: node id, bit rate and serial number 5, 500, 123456 become {seen}; changes: {changes}")
sys.exit([int(value, 0) for value in seen] != [5, 500, 1] or any("Serial" in change for change in changes))
PYTHON
