#!/usr/bin/env bash
# canopen 6.2.1 (npm) and the unit of a PDO's inhibit time.
#
# Input: a TPDO of type 254 without an event timer, 0x1800:03 (inhibit time) = 500, and an object that changes every
# 5 ms for a second. CiA 301: the inhibit time is a multiple of 100 us, so 500 is 50 ms.
# Seen: about 2 TPDOs in the second: 500 is taken as milliseconds. The EMCY inhibit time of the same package (0x1015)
# is in units of 100 us.
# One would guess about 20.
# Why it matters: values reach a controller ten times too seldom, and its watchdog, made for 50 ms, sees a dead device.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

cat >send.js <<'JAVASCRIPT'
const { Device, Eds } = require('canopen');
const eds = new Eds();
const object = eds.addEntry(0x2000, { parameterName: 'Value', objectType: 7, dataType: 7, accessType: 'rw', pdoMapping: true });
eds.addTransmitPdo({ cobId: 0x185, transmissionType: 254, inhibitTime: 500, dataObjects: [object] });
const device = new Device({ eds, id: 5 });
let count = 0;
device.on('message', ({ id }) => { count += id === 0x185; });
device.start();
device.receive({ id: 0, data: Buffer.from([1, 5]) }); // NMT start
let value = 0;
const changes = setInterval(() => { object.value = ++value; }, 5);
setTimeout(() => {
    clearInterval(changes);
    console.log(`canopen ${require('canopen/package.json').version} (npm): ${value} changes, inhibit time 500 (50 ms): ${count} TPDOs in 1.1 s`);
    process.exit(count >= 1 && count <= 4 ? 0 : 1);
}, 1100);
JAVASCRIPT
node send.js
