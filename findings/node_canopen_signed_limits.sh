#!/usr/bin/env bash
# canopen 6.2.1 (npm) and the limits of a signed object in hexadecimal.
#
# Input: an EDS with an INTEGER16, LowLimit=0x8000, HighLimit=0x7FFF, its whole range. Makers' tools write limits of
# signed objects so, as the bits of the value (CiA 306 gives limits the same form as the value).
# Seen: the whole file is refused: "highLimit may not be less lowLimit"; no section and no object is named. The same
# file with LowLimit=-32768 is read.
# One would guess -32768 to 32767 for both.
# Why it matters: the message blames the file for limits that are in order, and a user who cannot find the object
# among several hundred takes the limits out, with the protection that they gave.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

eds() { # an EDS whose object has the LowLimit $1
    cat <<EDS
[ManufacturerObjects]
SupportedObjects=1
1=0x2001
[2001]
ParameterName=Speed
ObjectType=0x7
DataType=0x0003
AccessType=rw
LowLimit=$1
HighLimit=0x7FFF
EDS
}
eds 0x8000 >bits.eds
eds -32768 >decimal.eds
cat >read.js <<'JAVASCRIPT'
const { Eds } = require('canopen');
const read = path => {
    try {
        const { lowLimit, highLimit } = Eds.fromFile(path).getEntry(0x2001);
        return `${lowLimit} to ${highLimit}`;
    } catch (error) {
        return error.message;
    }
};
const seen = ['bits.eds', 'decimal.eds'].map(read);
console.log(`canopen ${require('canopen/package.json').version} (npm): 0x8000: "${seen[0]}"; -32768: "${seen[1]}"`);
process.exit(seen[0] === 'highLimit may not be less lowLimit' && seen[1] === '-32768 to 32767' ? 0 : 1);
JAVASCRIPT
node read.js
