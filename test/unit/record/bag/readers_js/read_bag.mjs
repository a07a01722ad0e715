// Prints, as one JSON object, what the packages that Foxglove uses find in an MCAP file:
// once through its summary and indexes, once as a stream with all checksums compared.
import { open, readFile } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { decompress } from "fzstd";

const path = process.argv[2];
const decompressHandlers = {
  zstd: (data, size) => decompress(data, new Uint8Array(Number(size))),
};

/** Random access to a file, as McapIndexedReader asks for. */
class FileReadable {
  constructor(file) {
    this.file = file;
  }

  async size() {
    return BigInt((await this.file.stat()).size);
  }

  async read(offset, length) {
    const buffer = new Uint8Array(Number(length));
    await this.file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  }
}

/** JSON of messages: typed arrays as arrays, 64-bit integers as text, NaN as null. */
function plain(key, value) {
  if (ArrayBuffer.isView(value)) {
    return Array.from(value);
  }
  return typeof value === "bigint" ? value.toString() : value;
}

function base64(numbers) {
  return Buffer.from(numbers.buffer, numbers.byteOffset, numbers.byteLength).toString("base64");
}

const result = { topics: {}, samples: [], metadata: {}, streamed: {} };

const file = await open(path);
const indexed = await McapIndexedReader.Initialize({
  readable: new FileReadable(file),
  decompressHandlers,
});
result.profile = indexed.header.profile;
result.library = indexed.header.library;
const readers = new Map();
for (const channel of indexed.channelsById.values()) {
  const schema = indexed.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  readers.set(channel.id, new MessageReader(parse(text, { ros2: true })));
  result.topics[channel.topic] = {
    type: schema.name,
    encoding: schema.encoding,
    metadata: Object.fromEntries(channel.metadata),
    count: 0,
    last: null,
  };
}
for await (const message of indexed.readMessages()) {
  const channel = indexed.channelsById.get(message.channelId);
  const decoded = readers.get(message.channelId).readMessage(message.data);
  const topic = result.topics[channel.topic];
  topic.count += 1;
  if (channel.topic === "/ema/samples") {
    result.samples.push(base64(decoded.data));
    topic.last = decoded.layout;
  } else {
    topic.last = decoded;
  }
}
for await (const metadata of indexed.readMetadata()) {
  result.metadata[metadata.name] = Object.fromEntries(metadata.metadata);
}
await file.close();

const stream = new McapStreamReader({ validateCrcs: true, decompressHandlers });
stream.append(await readFile(path));
const topicOf = new Map();
for (let record; (record = stream.nextRecord()) != undefined; ) {
  if (record.type === "Channel") {
    topicOf.set(record.id, record.topic);
  } else if (record.type === "Message") {
    const topic = topicOf.get(record.channelId);
    result.streamed[topic] = (result.streamed[topic] ?? 0) + 1;
  }
}
result.done = stream.done();

console.log(JSON.stringify(result, plain));
