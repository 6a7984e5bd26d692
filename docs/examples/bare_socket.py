"""Query a running robot without this package: one JSON object per line over a Unix socket."""

import json
import os
import socket

PATH = os.environ["XDG_RUNTIME_DIR"] + "/canopen_control/robot-robby.sock"

with socket.socket(socket.AF_UNIX) as robot:
    robot.connect(PATH)
    lines = robot.makefile("rw")
    print("protocol", json.loads(lines.readline())["hello"]["protocol"])
    lines.write(json.dumps({"id": 1, "method": "status", "params": {}}) + "\n")
    lines.flush()
    status = json.loads(lines.readline())["result"]
    for name, joint in status["joints"].items():
        print(name, joint["position"])
