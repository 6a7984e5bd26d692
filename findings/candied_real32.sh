#!/usr/bin/env bash
# candied 2.2.0 (npm) and a REAL32 object in a DBC.
#
# Input: a DBC of a TPDO with a temperature, REAL32: 32 bits, and SIG_VALTYPE_ 1 (IEEE float). A frame carries 36.5.
# Seen: the parser gives the signal dataType "float", and its value is 1108475904, with the unit: the bits of 36.5 as a
# whole number.
# One would guess 36.5, since the type is known.
# Why it matters: no error and no NaN tells that the value is wrong, and around one value the number is plausible in
# its order: 36.5 and 37 differ by 131072 of 1.1e9, which a plot with its own scale shows as the right curve.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund candied@2.2.0 >npm.log 2>&1 || exit 2

cat >decode.js <<'JAVASCRIPT'
const { Can, Dbc } = require('candied');
const text = `VERSION ""

NS_:

BS_:

BU_: drive master

BO_ 389 TPDO_1: 4 drive
 SG_ temperature : 0|32@1- (1,0) [0|0] "degC" master

SIG_VALTYPE_ 389 temperature : 1;
`;
const can = new Can();
const database = new Dbc().load(text);
can.database = database;
const { dataType } = database.messages.get('TPDO_1').signals.get('temperature');
const data = Buffer.alloc(4);
data.writeFloatLE(36.5);
const { physValue } = can.decode(can.createFrame(389, [...data])).boundSignals.get('temperature');
console.log(`candied ${require('candied/package.json').version} (npm): 36.5 as REAL32: "${physValue}", type ${dataType}`);
process.exit(dataType === 'float' && physValue === '1108475904 degC' ? 0 : 1);
JAVASCRIPT
node decode.js
