#!/usr/bin/env bash
# canopen 6.2.1 (npm) and the end of a segmented upload.
#
# Input: a device with 9 bytes of text in 0x2000. A client reads it by segments: initiate, then segments with an
# alternating toggle bit until the server sets bit c, "no more segments".
# Seen: four answers for two segments of data: the size (9), 7 bytes, 2 bytes without c, and a segment of 0 bytes
# (n = 7) with c.
# One would guess c in the segment with the last two bytes, as CiA 301 describes it (SDO upload segment).
# Why it matters: a client that stops at the announced 9 bytes never takes the fourth answer; the server keeps its
# transfer open, and a client that counts segments, or one that refuses an empty one, reports an error.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

cat >upload.js <<'JAVASCRIPT'
const { Device, Eds } = require('canopen');
const eds = new Eds();
eds.addEntry(0x2000, { parameterName: 'Text', objectType: 7, dataType: 9, accessType: 'ro', defaultValue: '123456789' });
eds.addSdoServerParameter(1, 0x585, 0x605);
const device = new Device({ eds, id: 5 });
const answers = [];
device.on('message', ({ id, data }) => {
    if (id !== 0x585) return;
    answers.push(data.toString('hex'));
    if (data[0] >> 5 === 0 && data[0] & 1) return;
    const request = Buffer.alloc(8);
    request[0] = 0x60 | ((answers.length - 1) & 1) << 4;
    setImmediate(() => device.receive({ id: 0x605, data: request }));
});
device.start();
device.receive({ id: 0, data: Buffer.from([1, 5]) }); // NMT start
setTimeout(() => device.receive({ id: 0x605, data: Buffer.from('4000200000000000', 'hex') }), 50);
setTimeout(() => {
    console.log(`canopen ${require('canopen/package.json').version} (npm), upload of 9 bytes: ${answers.join(', ')}`);
    process.exit(answers.slice(1).map(answer => answer.slice(0, 2)).join() === '00,1a,0f' ? 0 : 1);
}, 300);
JAVASCRIPT
node upload.js
