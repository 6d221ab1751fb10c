// Reads an MCAP file with @mcap/core's indexed reader and prints what it found as one JSON object.
// usage: node read_with_mcap_core.mjs FILE     (modules are looked for in NODE_PATH)
import { createRequire } from "node:module";
import { open } from "node:fs/promises";

const require = createRequire(import.meta.url);
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, buffer.length, Number(offset));
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
const counts = {};
let last = -1n;
let ordered = true;
for await (const message of reader.readMessages()) {
  const topic = reader.channelsById.get(message.channelId).topic;
  counts[topic] = (counts[topic] ?? 0) + 1;
  ordered &&= message.logTime >= last;
  last = message.logTime;
}
const attachments = [];
for await (const attachment of reader.readAttachments()) attachments.push(attachment.name);
const metadata = [];
for await (const record of reader.readMetadata()) metadata.push(record.name);
console.log(JSON.stringify({ counts, ordered, attachments, metadata, messages: Number(reader.statistics.messageCount) }));
await file.close();
