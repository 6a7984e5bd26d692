"""The CANopen master: configuration, boot, supervision and process data of a bus."""
