#!/usr/bin/env bash
# canopen 6.2.1 (npm) and a client that changes the block size during a block upload.
#
# Input: a device with 35 bytes in 0x2000, "0123...". A client reads them by block upload: the first block of 3
# segments; its confirmation, in which it asks for blocks of 2. CiA 301 has every confirmation carry the size of the
# next block, and receivers with small buffers use that.
# Seen: the second block does not begin with byte 21, where the first one ended, but with byte 14: the position is the
# number of blocks times the new size. The bytes 14 to 20 come twice.
# One would guess the bytes in order, for any sequence of block sizes.
# Why it matters: with a CRC the client refuses the transfer; without one it has a wrong file of the right look.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

cat >upload.js <<'JAVASCRIPT'
const { Device, Eds } = require('canopen');
const text = '0123456789abcdefghijklmnopqrstuvwxy';
const eds = new Eds();
eds.addEntry(0x2000, { parameterName: 'Text', objectType: 7, dataType: 9, accessType: 'ro', defaultValue: text });
eds.addSdoServerParameter(1, 0x585, 0x605);
const device = new Device({ eds, id: 5 });
const request = hex => device.receive({ id: 0x605, data: Buffer.from(hex, 'hex') });
const blocks = [[]];
device.on('message', ({ id, data }) => {
    if (id !== 0x585) return;
    if (data[0] === 0xc6) { // initiated: the size follows
        setImmediate(() => request('a300000000000000'));
        return;
    }
    blocks.at(-1).push(data.toString('latin1', 1));
    if (blocks.length === 1 && blocks[0].length === 3) {
        blocks.push([]);
        setImmediate(() => request('a203020000000000'));
    }
});
device.start();
device.receive({ id: 0, data: Buffer.from([1, 5]) }); // NMT start
setTimeout(() => request('a400200003000000'), 50);
setTimeout(() => {
    console.log(`canopen ${require('canopen/package.json').version} (npm): ${JSON.stringify(blocks)}`);
    process.exit(blocks[0].join('') === text.slice(0, 21) && blocks[1][0] === text.slice(14, 21) ? 0 : 1);
}, 400);
JAVASCRIPT
node upload.js
