#!/usr/bin/env bash
# canopen-lens 0.5.1 (PyPI) and a candump log in which two frames share a time stamp.
#
# Input: candump's log format, absolute Unix times, pairs of frames with the same stamp 20 ms apart: SYNC and the TPDO
# that was read together with it. Recorders that stamp a whole reading write such files.
# Seen: the file of 0.4 s is told to be 66300000007.6 s long, and "No problems found": absolute times are added up as
# if each were the time since the frame before. With one microsecond between the two frames it is 0.4 s.
# One would guess 0.4 s for both: equal stamps are allowed, and no time of 1.7e9 s is a difference.
# Why it matters: every period and every gap of heartbeats in the verdict is wrong, and the verdict looks good.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen-lens==0.5.1 2>/dev/null || exit 2

log() { # the microseconds between the two frames of a pair
    python3 - "$1" <<'PYTHON'
import sys
for number in range(20):
    for apart, frame in ((0, "080#"), (int(sys.argv[1]), "183#0102")):
        print(f"(1700000000.{number * 20_000 + apart:06d}) can0 {frame}")
PYTHON
}

length() { "$folder/venv/bin/canopen-lens" --lang en --no-color "$1" | grep -oE '[0-9.]+ s ' | head -1; }

log 0 >"$folder/equal.log"
log 1 >"$folder/apart.log"
equal=$(length "$folder/equal.log") apart=$(length "$folder/apart.log")
echo "canopen-lens $("$folder/venv/bin/python" -c 'import importlib.metadata as m; print(m.version("canopen-lens"))'):" \
    "equal stamps: $equal, one microsecond apart: $apart"
[ "$equal" = "66300000007.6 s " ] && [ "$apart" = "0.4 s " ]
