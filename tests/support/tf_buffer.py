"""A buffer of transforms as tf2 has it: one parent of each frame, and between two samples what lies on the way.

Messages are dicts as `ros.Peer` tells them. A lookup fails as one of tf2 does: for a frame that nobody has told, for
two that no chain joins, and for a time before the first or after the last sample of a moving frame.
"""

from __future__ import annotations

import math


class TransformBuffer:
    """Takes TFMessages; `lookup` tells where a frame is in another one at a time in ns."""

    def __init__(self):
        self._samples, self._fixed, self._parents = {}, {}, {}

    def take(self, message, *, fixed=False):
        """Keep the transforms of a message; ValueError for what tf2 throws away."""
        for transform in message["transforms"]:
            parent, child = transform["header"]["frame_id"], transform["child_frame_id"]
            place, turn = (tuple(map(transform["transform"][part].get, names)) for part, names in _PARTS)
            if not parent or not child or "/" in (parent[0], child[0]) or parent == child:
                raise ValueError(f"{parent!r} to {child!r} is not a transform")
            if not math.isclose(math.hypot(*turn), 1.0, abs_tol=1e-3) or not all(map(math.isfinite, place)):
                raise ValueError(f"{child}: {place} {turn} is not a pose")
            if self._parents.setdefault(child, parent) != parent:
                raise ValueError(f"{child} has two parents: {parent} and {self._parents[child]}")
            if fixed:
                self._fixed[child] = place, turn
            else:
                self._samples.setdefault(child, {})[stamp_ns(transform["header"])] = place, turn

    def reaches(self, frame):
        """Return the time of the last sample of a moving frame in ns, 0 without one."""
        return max(self._samples.get(frame, {0: None}))

    def lookup(self, target, source, time_ns):
        """Return the position of the origin of `source` in `target`, and its rotation; LookupError."""
        up, down = self._chain(source), self._chain(target)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            raise LookupError(f"nothing connects {target} and {source}")
        place, turn = self._in(common, up, time_ns)
        own_place, own_turn = self._in(common, down, time_ns)
        back = (*(-component for component in own_turn[:3]), own_turn[3])
        return _turned(back, tuple(a - b for a, b in zip(place, own_place, strict=True))), _times(back, turn)

    def _chain(self, frame):
        if frame not in self._parents and frame not in self._parents.values():
            raise LookupError(f"frame {frame} does not exist")
        chain = [frame]
        while chain[-1] in self._parents:
            chain.append(self._parents[chain[-1]])
        return chain

    def _in(self, root, chain, time_ns):
        place, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        for frame in chain[: chain.index(root)]:
            moved, turned = self._fixed.get(frame) or self._at(frame, time_ns)
            place = tuple(a + b for a, b in zip(moved, _turned(turned, place), strict=True))
            turn = _times(turned, turn)
        return place, turn

    def _at(self, frame, time_ns):
        samples = self._samples[frame]
        before, after = ([t for t in samples if t <= time_ns], [t for t in samples if t >= time_ns])
        if not before or not after:
            raise LookupError(f"{frame} at {time_ns}: extrapolation, there is {min(samples)} to {max(samples)}")
        first, last = max(before), min(after)
        part = 0.0 if first == last else (time_ns - first) / (last - first)
        (place, turn), (end, end_turn) = samples[first], samples[last]
        sign = 1.0 if sum(a * b for a, b in zip(turn, end_turn, strict=True)) >= 0.0 else -1.0
        mixed = [a + part * (sign * b - a) for a, b in zip(turn, end_turn, strict=True)]
        length = math.hypot(*mixed)
        return tuple(a + part * (b - a) for a, b in zip(place, end, strict=True)), tuple(
            component / length for component in mixed
        )


_PARTS = (("translation", "xyz"), ("rotation", "xyzw"))


def stamp_ns(header):
    """Return the stamp of a header in ns."""
    return header["stamp"]["sec"] * 1_000_000_000 + header["stamp"]["nanosec"]


def _times(first, second):
    a, b, c, d = first
    e, f, g, h = second
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def _turned(turn, vector):
    back = (*(-component for component in turn[:3]), turn[3])
    return _times(_times(turn, (*vector, 0.0)), back)[:3]
