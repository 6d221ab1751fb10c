// npm's canopen in virtual time, as a device or as a master: node canopen_virtual.js NODE-ID [EDS]
// One line of JSON in, one out: {now, frame: [id, hex] | call: text} -> {frames: [[id, hex]], due, done}, times in ms.
'use strict';
const fs = require('fs');
const os = require('os');
const path = require('path');
const readline = require('readline');

const later = global.setImmediate;
const timers = new Map();
let now = 0, serial = 0;

class Timer {
    constructor(act, ms, repeat) {
        Object.assign(this, { act, ms: Math.max(ms || 0, repeat ? 1 : 0), repeat, number: ++serial });
        this.refresh();
    }
    refresh() { this.due = now + this.ms; timers.set(this.number, this); return this; }
    unref() { return this; }
    ref() { return this; }
}
global.setTimeout = (act, ms, ...given) => new Timer(() => act(...given), ms, false);
global.setInterval = (act, ms, ...given) => new Timer(() => act(...given), ms, true);
global.clearTimeout = global.clearInterval = (timer) => timer && timers.delete(timer.number);
Date.now = () => now;

const canopen = require('canopen');
const { DataType, Device, Eds } = canopen;
const [number, file] = process.argv.slice(2);
const id = Number(number);

function dictionary() { // This reader takes no $NODEID, and a mapped dummy's index must be an entry.
    const written = path.join(fs.mkdtempSync(path.join(os.tmpdir(), 'canopen-')), path.basename(file));
    const text = fs.readFileSync(file, 'utf8');
    fs.writeFileSync(written, text.replace(/\$NODEID\s*\+\s*(0x[0-9A-Fa-f]+|\d+)/g, (_, base) => String(Number(base) + id)));
    const eds = Eds.fromFile(written);
    for (const type of [DataType.INTEGER32, DataType.UNSIGNED16])
        eds.addEntry(type, { parameterName: `dummy ${type}`, dataType: type, accessType: 'rw' });
    return eds;
}

const device = new Device({ eds: file ? dictionary() : new Eds(), id, enableLss: true });
let frames = [], done = [];
device.addListener('message', (message) => frames.push([message.id, Buffer.from(message.data).toString('hex')]));
device.start();

const due = () => [...timers.values()].sort((a, b) => a.due - b.due || a.number - b.number)[0];
const turn = (act) => new Promise((resolve) => { act(); later(() => later(resolve)); });

async function take(told) {
    for (let timer = due(); timer && timer.due <= told.now; timer = due()) {
        now = timer.due;
        if (timer.repeat) timer.refresh(); else timers.delete(timer.number);
        await turn(timer.act);
    }
    now = told.now;
    if (told.frame) {
        const data = Buffer.from(told.frame[1], 'hex');
        await turn(() => device.receive({ id: told.frame[0], data, len: data.length }));
    }
    if (told.call) {
        const run = new Function('device', 'canopen', `return (async () => { ${told.call} })()`);
        await turn(() => run(device, canopen).then((value) => done.push({ value }),
            (error) => done.push({ error: `${error.name}: ${error.message}` })));
    }
    const next = due();
    process.stdout.write(JSON.stringify({ frames, due: next ? next.due : null, done }) + '\n');
    frames = [], done = [];
}

let queue = Promise.resolve();
readline.createInterface({ input: process.stdin }).on('line', (line) => {
    queue = queue.then(() => take(JSON.parse(line)));
});
