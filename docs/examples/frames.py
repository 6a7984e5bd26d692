"""Listen on the bus of a robot, frame by frame: heartbeats and the drives' statuswords."""

import select
import time
from collections import Counter

from canopen_control import Robot, frames_of, open_port

TPDO1, HEARTBEAT = 0x180, 0x700  # + node id: the predefined connection set of CANopen

seen: Counter[str] = Counter()
words: dict[int, int] = {}
with Robot.from_config("robby", can="memory:frames"):
    port = open_port("memory:frames", label="listener")
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        select.select([port], [], [], 0.1)  # receive() never blocks; wait on the port's descriptor
        for frame in frames_of(port.receive()):
            service, node_id = frame.can_id & ~0x7F, frame.can_id & 0x7F
            if service == HEARTBEAT:
                seen[f"heartbeats of node {node_id}"] += 1
            elif service == TPDO1:
                words[node_id] = int.from_bytes(frame.data[:2], "little")
    port.close()

for text, count in sorted(seen.items()):
    print(f"{text}: {count}")
for node_id, word in sorted(words.items()):
    print(f"node {node_id}: statusword 0x{word:04X}, {'enabled' if word & 0x6F == 0x27 else 'not enabled'}")
