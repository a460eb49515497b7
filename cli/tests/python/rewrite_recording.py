"""Rewrites a recording with the official MCAP writer, as other tools do.

usage: rewrite_recording.py RUN.mcap OUT.mcap lz4|zstd|none
"""

import sys

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

source, target, compression = sys.argv[1:]
with open(source, "rb") as file, open(target, "wb") as out:
    reader = make_reader(file)
    writer = Writer(out, compression=CompressionType[compression.upper()])
    writer.start(profile="ros2", library="another tool")
    for a in reader.iter_attachments():
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
    writer.add_attachment(0, 0, "camera.bin", "application/octet-stream", bytes(17 << 20))
    for m in reader.iter_metadata():
        writer.add_metadata(m.name, m.metadata)
    schemas, channels = {}, {}
    for schema, channel, m in reader.iter_messages(log_time_order=False):
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schemas[schema.id])
        writer.add_message(channels[channel.id], m.log_time, m.data, m.publish_time, m.sequence)
    writer.finish()
