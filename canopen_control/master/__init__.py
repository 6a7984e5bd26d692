"""CANopen master of a bus: configuration, boot, supervision and process data of the nodes."""
