#!/usr/bin/env bash
# canopen 6.2.1 (npm) and COB-IDs that an EDS gives as a formula.
#
# Input: an EDS with 0x1400:01 DefaultValue=$NODEID+0x200 and 0x1014 DefaultValue=$NODEID+0x80, the form of CiA 306 for
# values that depend on the node id. Files of most drives have it.
# Seen: both are read as 0, without an error. getEmcyCobId() and the receive PDO's COB-ID are 0, also in a Device with
# an id: the file is read before the device has its id, and nothing evaluates the formula later.
# One would guess 0x85 and 0x205 for node 5, or an error that names the formula.
# Why it matters: 0 is the identifier of NMT. A PDO with COB-ID 0 is no PDO, and its bit 31 says "valid".
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

cat >device.eds <<'EDS'
[DeviceInfo]
LSS_Supported=0
[MandatoryObjects]
SupportedObjects=0
[OptionalObjects]
SupportedObjects=2
1=0x1014
2=0x1400
[1014]
ParameterName=COB-ID EMCY
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x80
[1400]
ParameterName=RPDO 1
ObjectType=0x9
SubNumber=3
[1400sub0]
ParameterName=Highest sub-index
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=2
[1400sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x200
[1400sub2]
ParameterName=Transmission type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=255
EDS
cat >read.js <<'JAVASCRIPT'
const { Device, Eds } = require('canopen');
const { eds } = new Device({ eds: Eds.fromFile('device.eds'), id: 5 });
const values = [eds.getEntry(0x1014).value, eds.getSubEntry(0x1400, 1).value];
console.log(`canopen ${require('canopen/package.json').version} (npm): 0x1014 and 0x1400:01 of node 5: ${values}`);
process.exit(values.every(value => value === 0) ? 0 : 1);
JAVASCRIPT
node read.js
