/*
 * What Foxglove's own libraries find in a stream: `node read.js mcap FILE`, or `node read.js foxglove URL COUNT` for so
 * many messages of each channel of a server. A line on standard output is a channel ({"topic", "encoding", "schema"}) or
 * a message of one ({"topic", "time_ns", "data"}).
 */
'use strict';

const fs = require('fs');
const { McapIndexedReader, TempBuffer } = require('@mcap/core');
const { FoxgloveClient } = require('@foxglove/ws-protocol');
// The last release of the client asks for the protocol by the name that it had before Foxglove's SDK renamed it.
const PROTOCOL = 'foxglove.sdk.v1';
const fzstd = require('fzstd');
const { WebSocket } = require('ws');

const say = (content) => process.stdout.write(JSON.stringify(content) + '\n');
const text = (bytes) => new TextDecoder().decode(bytes);

async function readFile(path) {
    const decompressHandlers = { zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))) };
    const reader = await McapIndexedReader.Initialize({ readable: new TempBuffer(fs.readFileSync(path)), decompressHandlers });
    for (const channel of reader.channelsById.values()) {
        const schema = reader.schemasById.get(channel.schemaId);
        say({ topic: channel.topic, encoding: channel.messageEncoding, schema: JSON.parse(text(schema.data)) });
    }
    for await (const message of reader.readMessages()) {
        const { topic } = reader.channelsById.get(message.channelId);
        say({ topic, time_ns: String(message.logTime), data: JSON.parse(text(message.data)) });
    }
}

function listen(url, count) {
    const client = new FoxgloveClient({ ws: new WebSocket(url, [PROTOCOL]) });
    const topics = new Map(), heard = new Map();
    client.on('advertise', (channels) => {
        for (const channel of channels) {
            say({ topic: channel.topic, encoding: channel.encoding, schema: JSON.parse(channel.schema) });
            topics.set(client.subscribe(channel.id), channel.topic);
        }
    });
    client.on('message', ({ subscriptionId, timestamp, data }) => {
        const topic = topics.get(subscriptionId), number = (heard.get(topic) ?? 0) + 1;
        heard.set(topic, number);
        if (number <= count) say({ topic, time_ns: String(timestamp), data: JSON.parse(text(data)) });
        if (heard.size === topics.size && Math.min(...heard.values()) >= count) client.close();
    });
    client.on('error', (error) => { throw error; });
}

const [kind, place, count] = process.argv.slice(2);
if (kind === 'mcap') readFile(place);
else listen(place, Number(count));
