#!/usr/bin/env bash
# canopen 6.2.1 (npm) and TPDOs of transmission type 255.
#
# Input: two devices that differ in one byte: 0x1800:02 is 254 in one and 255 in the other. Both have an event timer of
# 20 ms and one mapped object, and are started. CiA 301 names both values event-driven: 254 by an event of the
# manufacturer, 255 by one of the device profile. 255 is what most EDS files have.
# Seen: with 254 a TPDO comes every 20 ms; with 255 none ever comes, on the timer or on a change.
# One would guess that both send, since the event timer is the same for both.
# Why it matters: a device made from a usual EDS is silent, without an error, until somebody tries 254.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && npm install --silent --no-audit --no-fund canopen@6.2.1 >npm.log 2>&1 || exit 2

cat >send.js <<'JAVASCRIPT'
const { Device, Eds } = require('canopen');
const sent = transmissionType => new Promise(resolve => {
    const eds = new Eds();
    const object = eds.addEntry(0x2000, { parameterName: 'Value', objectType: 7, dataType: 7, accessType: 'rw', pdoMapping: true });
    eds.addTransmitPdo({ cobId: 0x185, transmissionType, eventTime: 20, dataObjects: [object] });
    const device = new Device({ eds, id: 5 });
    let count = 0;
    device.on('message', ({ id }) => { count += id === 0x185; });
    device.start();
    device.receive({ id: 0, data: Buffer.from([1, 5]) }); // NMT start
    setTimeout(() => { object.value = 7; }, 100);
    setTimeout(() => { device.stop(); resolve(count); }, 500);
});
(async () => {
    const counts = [await sent(254), await sent(255)];
    console.log(`canopen ${require('canopen/package.json').version} (npm): TPDOs in 0.5 s: type 254: ${counts[0]}, type 255: ${counts[1]}`);
    process.exit(counts[0] > 0 && counts[1] === 0 ? 0 : 1);
})();
JAVASCRIPT
node send.js
