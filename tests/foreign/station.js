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
const { Device, Eds, LssMode, NmtState } = require('canopen');

const OWN_NODE = 0x7E;
const HEARTBEAT_TIMEOUT_MS = 60_000;
const SDO_TIMEOUT_MS = 20_000;
const OF_RPDOS = 0x3000;
const LSS_TIMEOUT_MS = 60;

const node = Number(process.argv[2]);
const outputs = new Map();

const say = (line) => process.stdout.write(line + '\n');
const event = (name, content) => say(JSON.stringify({ event: name, ...content }));

/** The station's own object for one of the node that an RPDO carries there. */
function output(own, { key, parameterName, dataType }) {
    const name = key.toLowerCase(), index = outputs.get(name) ?? OF_RPDOS + outputs.size;
    if (!outputs.has(name)) {
        outputs.set(name, index);
        own.addEntry(index, { parameterName, dataType });
    }
    return own.getEntry(index);
}

function stationFor(eds) {
    const own = new Eds();
    for (const { cobId, dataObjects } of eds.getReceivePdos())
        if (dataObjects.length)
            own.addTransmitPdo({ cobId, transmissionType: 255, dataObjects: dataObjects.map((object) => output(own, object)) });
    own.setSyncCobId(0x80);
    own.setSyncGenerationEnable(true);
    own.addHeartbeatConsumer(node, HEARTBEAT_TIMEOUT_MS);

    const station = new Device({ id: OWN_NODE, eds: own, enableLss: true });
    station.mapRemoteNode({ id: node, eds, dataStart: 0x4000, skipNmt: true, skipSdo: true });
    own.addSdoClientParameter(node, 0x600 + node, 0x580 + node);
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

    async pdo({ cob_id, values }) {
        for (const [key, value] of Object.entries(values))
            station.setValue(outputs.get(key), value);
        station.pdo.write(cob_id);
    },

    async find({ vendorId, productCode, revisionNumber }) {
        return await station.lss.fastscan({ vendorId, productCode, revisionNumber, timeout: LSS_TIMEOUT_MS });
    },

    async give_node_id({ node_id }) {
        await station.lss.configureNodeId(node_id, SDO_TIMEOUT_MS);
        await station.lss.storeConfiguration(SDO_TIMEOUT_MS);
        station.lss.switchModeGlobal(LssMode.OPERATION);
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
