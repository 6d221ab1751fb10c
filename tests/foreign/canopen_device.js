// A knee drive by npm's canopen on npm's socketcan: node canopen_device.js CHANNEL EDS NODE-ID
// It stays in SWITCH ON DISABLED, and shows as its position what it was last told as its target.
'use strict';
const fs = require('fs');
const os = require('os');
const path = require('path');
const { DataType, Device, Eds } = require('canopen');
const can = require('socketcan');

const [channelName, file, number] = process.argv.slice(2);
const id = Number(number);
const STATUSWORD = 0x6041, POSITION = 0x6064, TARGET = 0x607A;
const SWITCH_ON_DISABLED = 0x0040;

// This reader takes no $NODEID: it is written out, as a commissioning tool does.
const written = path.join(fs.mkdtempSync(path.join(os.tmpdir(), 'canopen-')), path.basename(file));
const text = fs.readFileSync(file, 'utf8');
fs.writeFileSync(written, text.replace(/\$NODEID\s*\+\s*(0x[0-9A-Fa-f]+|\d+)/g, (_, base) => String(Number(base) + id)));

const eds = Eds.fromFile(written);
for (const type of [DataType.INTEGER32, DataType.UNSIGNED16]) // a dummy's index is its data type
    eds.addEntry(type, { parameterName: `dummy ${type}`, dataType: type, accessType: 'rw' });

const device = new Device({ eds, id });
const channel = can.createRawChannel(channelName, true);
channel.addListener('onMessage', (message) => device.receive(message));
device.addListener('message', (message) => channel.send(message));
device.pdo.addListener('pdo', () => device.setValue(POSITION, device.getValue(TARGET)));
device.setValue(STATUSWORD, SWITCH_ON_DISABLED);
channel.start();
device.start();
console.log('ready');
