"""What a report says of a run, as `report --json` prints it and the page shows it.

Times in facts are seconds from `begin` (Unix); values are SI units, None where nothing was known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from canopen_control.rpc.messages.declare import Document
from canopen_control.rpc.messages.state import BootStep, RobotEvent, SdoCounts, TrackingReading, TruePose

if TYPE_CHECKING:
    from collections.abc import Mapping


Column: TypeAlias = list[float | None]


class Span(Document, frozen=True, rename={"begin": "from", "end": "to"}):
    """How long a state lasted, None for one that nobody knows."""

    begin: float
    end: float
    state: str | None


class NodeFacts(Document, frozen=True):
    """A node: the states of its communication, and of its axes by joint."""

    bus: str
    node_id: int
    nmt: list[Span]
    axes: dict[str, list[Span]]


class JointFacts(Document, frozen=True):
    """A joint over `time`: `quantity` is what its command means, `error` is command minus actual.

    `tracking` is what the master has seen last of how well it follows, None where it was not commanded.
    """

    quantity: str
    time: list[float]
    command: Column
    actual: Column
    error: Column
    position: Column
    velocity: Column
    effort: Column
    tracking: TrackingReading | None = None


class CycleFacts(Document, frozen=True, kw_only=True):
    """How the cycle kept time: `late_counts[i]` cycles were at most `late_edges_s[i]` late, the last of them later."""

    period_s: float
    count: int
    missed: int
    late_max_s: float
    work_max_s: float
    late_edges_s: list[float]
    late_counts: list[int]


class EventFacts(RobotEvent, frozen=True, kw_only=True, omit_defaults=True):
    """An event and when it was in the recording."""

    at: float


class FrameFacts(Document, frozen=True, kw_only=True):
    """A frame as a report shows it: `id` and `data` hexadecimal, `mark` how much it deserves a look."""

    time: float
    bus: str
    id: str
    data: str
    service: str
    node: str
    node_id: int | None
    text: str
    mark: str


class BusLoad(Document, frozen=True):
    """The load of a bus, a share of its bit rate, in the middle of each bin of time."""

    time: list[float]
    value: list[float]


class BusFacts(Document, frozen=True):
    """A bus: how many frames it carried, by service, `bitrate` in bit/s."""

    frames: int
    services: dict[str, int]
    bitrate: int
    load: BusLoad


class MeasuredFacts(Document, frozen=True):
    """A value that a controller told: the least, the most and the last of it in the recording."""

    controller: str
    what: str
    unit: str
    least: float
    most: float
    last: float


class Gaps(Document, frozen=True):
    """What is missing in a recording."""

    unheard: tuple[str, ...] = ()
    frames_lost: int = 0
    unread_lines: int = 0
    faults_left_out: int = 0
    notes: tuple[str, ...] = ()


class ReportFacts(Document, frozen=True, kw_only=True):
    """Everything: `summary` in sentences, `stopped_after_s` by joint that moved at the `fault`, None where unseen.

    `true_pose` is the last one of a simulated base.
    """

    summary: list[str]
    robot: str
    begin: float
    end: float
    seconds: float
    channels: dict[str, str]
    fault: EventFacts | None
    events: list[EventFacts]
    nodes: dict[str, NodeFacts]
    joints: dict[str, JointFacts]
    stopped_after_s: dict[str, float | None]
    last_state: str
    cycle: CycleFacts | None
    boot: list[BootStep]
    sdo: dict[str, SdoCounts]
    buses: dict[str, BusFacts]
    frames: list[FrameFacts]
    last_words: list[FrameFacts]
    gaps: Gaps
    measured: tuple[MeasuredFacts, ...] = ()
    true_pose: TruePose | None = None

    @property
    def fault_at(self) -> float | None:
        """When the fault was."""
        return None if self.fault is None else self.fault.at


def event_at(event: RobotEvent, begin: float) -> EventFacts:
    """Return an event with its time in a recording that begins at `begin`."""
    told: Mapping[str, object] = {name: getattr(event, name) for name in event.__struct_fields__}
    return EventFacts(at=round(event.time - begin, 6), **told)  # type: ignore[arg-type] # its own fields
