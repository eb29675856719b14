/*
 * A CANopen station on npm's canopen, which knows one node by its EDS: `node station.js NODE EDS`.
 *
 * A line on standard input is a frame of the bus (`185#0102`) or a request ({"id": 1, "do": "upload", ...}); a line on
 * standard output is a frame for the bus, the answer to a request ({"id": 1, "value": ...} or {"id": 1, "abort": code})
 * or an event ({"event": "heartbeat", ...}). Data are hexadecimal digits.
 */
'use strict';

const { once } = require('events');
const readline = require('readline');
const { DataType, Device, Eds, NmtState } = require('canopen');

const OWN_NODE = 0x7E;
const HEARTBEAT_TIMEOUT_MS = 60_000;
const SDO_TIMEOUT_MS = 20_000;
const CONTROLWORD = 0x3000, TARGET_VELOCITY = 0x3001;

const node = Number(process.argv[2]);
const rpdo1 = 0x200 + node;

const say = (line) => process.stdout.write(line + '\n');
const event = (name, content) => say(JSON.stringify({ event: name, ...content }));

function stationFor(eds) {
    const own = new Eds();
    own.addEntry(CONTROLWORD, { parameterName: 'Controlword', dataType: DataType.UNSIGNED16 });
    own.addEntry(TARGET_VELOCITY, { parameterName: 'Target velocity', dataType: DataType.INTEGER32 });
    own.addTransmitPdo({
        cobId: rpdo1,
        transmissionType: 255,
        dataObjects: [own.getEntry(CONTROLWORD), own.getEntry(TARGET_VELOCITY)],
    });
    own.setSyncCobId(0x80);
    own.setSyncGenerationEnable(true);
    own.addHeartbeatConsumer(node, HEARTBEAT_TIMEOUT_MS);

    const station = new Device({ id: OWN_NODE, eds: own });
    station.mapRemoteNode({ id: node, eds, dataStart: 0x4000 });
    station.on('message', ({ id, data }) => say(id.toString(16).padStart(3, '0') + '#' + data.toString('hex')));
    station.nmt.on('heartbeat', ({ deviceId, state }) => event('heartbeat', { node: deviceId, state }));
    station.emcy.on('emergency', ({ cobId, em }) =>
        event('emergency', { cob_id: cobId, code: em.code, register: em.register, info: em.info.toString('hex') }));
    station.pdo.on('pdo', ({ cobId, dataObjects }) =>
        event('pdo', {
            cob_id: cobId,
            values: Object.fromEntries(dataObjects.map((object) => [object.parameterName, object.value])),
        }));
    station.start();
    station.nmt.setState(NmtState.OPERATIONAL);
    return station;
}

const station = stationFor(Eds.fromFile(process.argv[3]));

const requests = {
    async upload({ index, sub, block }) {
        const data = await station.sdo.upload({
            deviceId: node, index, subIndex: sub, blockTransfer: block, timeout: SDO_TIMEOUT_MS,
        });
        return data.toString('hex');
    },

    async download({ index, sub, block, data }) {
        await station.sdo.download({
            deviceId: node, index, subIndex: sub, blockTransfer: block, blockInterval: 0, timeout: SDO_TIMEOUT_MS,
            data: Buffer.from(data, 'hex'),
        });
    },

    async nmt({ service }) {
        station.nmt[service](node);
    },

    async heartbeat({ period_ms }) {
        station.eds.setHeartbeatProducerTime(period_ms);
        if (period_ms)
            await once(station.nmt, 'message');
    },

    async sync() {
        station.sync.write();
    },

    async sync_every({ period_us }) {
        station.eds.setSyncCyclePeriod(period_us);
    },

    async command({ controlword, target_velocity }) {
        station.setValue(CONTROLWORD, controlword);
        station.setValue(TARGET_VELOCITY, target_velocity);
        station.pdo.write(rpdo1);
    },
};

async function answer(request) {
    try {
        const value = await requests[request.do](request);
        say(JSON.stringify({ id: request.id, value: value ?? null }));
    } catch (error) {
        if (error.code === undefined)
            throw error;
        say(JSON.stringify({ id: request.id, abort: error.code }));
    }
}

readline.createInterface({ input: process.stdin }).on('line', (line) => {
    if (line.startsWith('{')) {
        answer(JSON.parse(line));
        return;
    }
    const [id, data] = line.split('#');
    station.receive({ id: parseInt(id, 16), data: Buffer.from(data, 'hex') });
}).on('close', () => process.exit());
