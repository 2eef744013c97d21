// Reads a bag as Foxglove does: @mcap/core's indexed reader, which checks CRCs, and Foxglove's own
// ros2msg parser and CDR deserialiser. Prints, as JSON, messages by topic and all steering angles.
'use strict';
const { open } = require('node:fs/promises');
const { McapIndexedReader } = require('@mcap/core');
const { parse } = require('@foxglove/rosmsg');
const { MessageReader } = require('@foxglove/rosmsg2-serialization');
const fzstd = require('fzstd');

class File {
  constructor(handle) {
    this.handle = handle;
  }
  async size() {
    return BigInt((await this.handle.stat()).size);
  }
  async read(offset, length) {
    const buffer = new Uint8Array(Number(length));
    await this.handle.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  }
}

async function main(path) {
  const handle = await open(path, 'r');
  const decompressHandlers = { zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))) };
  const reader = await McapIndexedReader.Initialize({ readable: new File(handle), decompressHandlers });
  const decoders = new Map();
  const counts = {};
  const angles = [];
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!decoders.has(schema.id)) {
      const text = new TextDecoder().decode(schema.data);
      decoders.set(schema.id, new MessageReader(parse(text, { ros2: true })));
    }
    const value = decoders.get(schema.id).readMessage(message.data);
    counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
    if (channel.topic === '/taxi_command') angles.push(value.steering_angle);
  }
  const attachments = [];
  for await (const attachment of reader.readAttachments()) attachments.push(attachment.name);
  await handle.close();
  console.log(JSON.stringify({ profile: reader.header.profile, counts, angles, attachments }));
}

main(process.argv[2]).catch((error) => {
  console.error(error);
  process.exit(1);
});
