#!/usr/bin/env bash
# candied 2.2.0 (npm) and a value beyond the limits of its signal.
#
# Input: a DBC with a TPDO of a drive: position, 16 bits, signed, factor 1, [-3000|3000], the limits of its EDS; and the
# same PDO with [0|0], "no limits". Frames with the positions 100, 5000 and -5000.
# Seen: with limits 100, 3000 and -3000, with the unit, as if the drive had sent them; without 100, 5000 and -5000.
# One would guess 5000 and -5000 in both: the limits describe a signal, and other readers of DBC files report the value
# as it is.
# Why it matters: a drive that ran beyond its range is seen standing at its end, and that is the one moment at which
# the value counts. A plot shows a flat line, and an alarm "beyond 3000" never comes.
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

BO_ 389 TPDO_1: 2 drive
 SG_ position : 0|16@1- (1,0) [-3000|3000] "counts" master

BO_ 645 TPDO_2: 2 drive
 SG_ position : 0|16@1- (1,0) [0|0] "counts" master
`;
const can = new Can();
can.database = new Dbc().load(text);
const position = (id, value) => {
    const data = Buffer.alloc(2);
    data.writeInt16LE(value);
    return can.decode(can.createFrame(id, [...data])).boundSignals.get('position').physValue;
};
const values = [100, 5000, -5000];
const seen = [389, 645].map(id => values.map(value => position(id, value)).join(', '));
console.log(`candied ${require('candied/package.json').version} (npm): with limits: ${seen[0]}; without: ${seen[1]}`);
const unlike = '100 counts, 3000 counts, -3000 counts|100 counts, 5000 counts, -5000 counts';
process.exit(seen.join('|') === unlike ? 0 : 1);
JAVASCRIPT
node decode.js
