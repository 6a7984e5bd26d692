"""A mixed campaign against a robot: random faults, kills, hostile clients and bus floods, with an independent observer.

It starts robby on an embedded bus, in folders of its own, commands it from several sides, and breaks whatever can be
broken, by a script drawn from the seed. Meanwhile it hears the bus, and nothing else, and tells every breach of:

  target, motion  nothing moves without an enable and a command newer than it, whose source is there and in time
  stop            after any stop reason both shafts stand, within detection and ramp as bus.yml has them
  lost_stop       `stop` gets in and is answered within 2 s, whoever else talks
  orphan          10 s after `kill -9` of the run nobody of it is left
  memory          the runtime does not grow after its warm-up
  traceback, output  no traceback anywhere, no flood of lines
  start, end, recovery  it starts, it ends, and it is enabled again when all was mended

Exit codes: 0 no breach, 1 breaches, 2 usage. The same seed and time give the same actions. With --hours or --page it is
the nightly campaign in virtual time instead: tools/campaign --hours 1 --help. With --properties it is the properties of
the tests with random examples: tools/campaign --properties --help.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from campaigner.driver import Driver
from campaigner.listen import Listener
from campaigner.observer import Breach, Observer
from campaigner.script import TOP_SPEED, make_script, read_script
from campaigner.stage import Stage
from campaigner.wire import read_wire
from canopen_control.errors import CanopenError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from campaigner.script import Action

ROOT: Final = Path(__file__).parents[2]
CONFIG: Final = ROOT / "config" / "robby"
_SHOWN_ACTIONS: Final = 6
_SHOWN_FRAMES: Final = 400
_UNITS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0}


class Campaign:
    """One campaign: its folder, its actions and its findings."""

    def __init__(self, args: argparse.Namespace, actions: list[Action], folder: Path) -> None:
        self.args, self.actions, self.folder = args, actions, folder
        self.begin = time.monotonic()
        self.interrupted = False
        self.found: list[dict[str, object]] = []
        self._lock = threading.Lock()
        self._driver: Driver | None = None
        self._ended = threading.Event()

    def run(self) -> int:
        """Run the whole campaign and return the exit code."""
        observer = Observer(read_wire(CONFIG / "bus.yml"), TOP_SPEED)
        listener = Listener(self.args.can, observer)
        outputs = self.folder / "output"
        outputs.mkdir()
        stage = Stage(outputs, CONFIG, listener, self.report, self.say, ros=self.args.ros)
        driver = self._driver = Driver(stage, Path(os.environ["XDG_STATE_HOME"]), self.say, self.report)
        watcher = threading.Thread(target=self._watch, args=(listener,), daemon=True)
        watcher.start()
        try:
            self.begin = time.monotonic()
            stage.recover(lambda: None)
            driver.play(self.actions, self.args.seconds)
        except KeyboardInterrupt:
            self.interrupted = True
            self.say("interrupted")
        finally:
            driver.close()
            with contextlib.suppress(KeyboardInterrupt):
                stage.close()
            self._ended.set()
            watcher.join()
            listener.close()
            self._take(listener)
        if observer.moved_s == 0.0 and not self.interrupted:
            self.report(Breach(time.monotonic(), "nothing", "no shaft was ever seen to move: nothing was tried"))
        self._summary(listener, driver, stage.starts)
        return 1 if self.found or self.interrupted else 0

    def _watch(self, listener: Listener) -> None:
        while not self._ended.wait(0.2):
            self._take(listener)

    def _take(self, listener: Listener) -> None:
        for breach, frames in listener.take_breaches():
            self.report(breach, frames)

    # ----------------------------------------------------------------------------------------- reporting

    def say(self, text: str) -> None:
        """Print a line, unless only JSON output is wanted."""
        print(text, file=sys.stderr if self.args.json else sys.stdout, flush=True)

    def report(self, breach: Breach, frames: Sequence[str] = ()) -> None:
        """Report a breach with the current action, and print how to replay it."""
        with self._lock:
            number = len(self.found) + 1
            doing = [str(action) for action in (self._driver.done if self._driver else [])[-_SHOWN_ACTIONS:]]
            path = self.folder / f"breach-{number}.txt"
            lines = [f"# {breach.rule}: {breach.text}", f"# all of it: {self._replay()}"]
            lines += [f"# the end of it: tools/campaign --replay {path} --for 60s", *doing]
            lines += [f"# {frame}" for frame in frames[-_SHOWN_FRAMES:]]
            path.write_text("\n".join(lines) + "\n")
            at = breach.time - (self._driver.begin if self._driver else self.begin)
            self.found.append(
                {"at": round(at, 2), "rule": breach.rule, "text": breach.text, "actions": doing, "file": str(path)}
            )
        self.say(f"BREACH {number} at {at:.2f}: {breach.rule}: {breach.text}")
        for line in doing[-3:]:
            self.say(f"           after: {line}")

    def _replay(self) -> str:
        ros = " --ros" if self.args.ros else ""
        what = f"--replay {self.args.replay}" if self.args.replay else f"--seed {self.args.seed}"
        return f"tools/campaign {what} --for {self.args.seconds:g}s{ros}"

    def _summary(self, listener: Listener, driver: Driver, starts: int) -> None:
        numbers = {
            "seed": self.args.seed,
            "seconds": round(time.monotonic() - self.begin, 1),
            "actions": len(driver.done),
            "by_kind": dict(sorted(driver.counts.items())),
            "starts": starts,
            "frames": listener.frames,
            "moved_s": round(listener.observer.moved_s, 1),
            "slowest_stop_s": round(max(driver.stops_s, default=0.0), 2),
            "memory_mb": round(max(process.most for process in driver.memory), 1),
            "growth_mb": round(max(process.growth for process in driver.memory), 1),
            "machine_stalled_s": round(listener.stalled_s, 2),
            "breaches": self.found,
            "again": self._replay(),
            "folder": str(self.folder),
        }
        if self.args.json:
            print(json.dumps(numbers, indent=2))
            return
        for key, value in numbers.items():
            if key != "breaches":
                print(f"{key:18} {value}")
        rules = [str(breach["rule"]) for breach in self.found]
        told = ", ".join(f"{rules.count(rule)} {rule}" for rule in dict.fromkeys(rules))
        print(f"{'breaches':18} {told or 'none'}")


def _seconds(text: str) -> float:
    unit = _UNITS.get(text[-1:], 0.0)
    try:
        value = float(text[:-1]) * unit if unit else float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time, such as 90s, 30m or 2h")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tools/campaign", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--for", type=_seconds, default=1800.0, dest="seconds", metavar="T", help="default: 30m")
    parser.add_argument("--seed", type=int, help="default: random, and printed")
    parser.add_argument("--replay", metavar="FILE", help="play the actions in FILE, one per line as printed")
    parser.add_argument("--list", action="store_true", help="print the actions without running them")
    parser.add_argument("--can", default="local:campaign", metavar="CHANNEL", help="default: local:campaign; or vcan0")
    parser.add_argument("--ros", action="store_true", help="run the ROS 2 bridge, and publishers that send commands")
    parser.add_argument("--keep", action="store_true", help="keep all logs and output, not only those of breaches")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    return parser


def _actions(parser: argparse.ArgumentParser, args: argparse.Namespace) -> list[Action]:
    if not args.replay:
        return make_script(args.seed, args.seconds)
    try:
        actions = read_script(Path(args.replay).read_text().splitlines())
    except (OSError, ValueError) as error:
        parser.error(f"--replay: {error}")
    # the last actions of a campaign start at once
    early = max(0.0, min((action.at for action in actions), default=0.0) - 1.0)
    return [replace(action, at=action.at - early) for action in actions]


@contextlib.contextmanager
def _own_folders(folder: Path) -> Iterator[None]:
    """Keep the sockets and logs of the campaign separate from those of other programs."""
    for name in ("run", "state"):
        (folder / name).mkdir(mode=0o700)
    own = {"XDG_RUNTIME_DIR": str(folder / "run"), "XDG_STATE_HOME": str(folder / "state")}
    own.update(ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_DOMAIN_ID=str(1 + os.getpid() % 100))
    os.environ.update(own)
    yield


def main(arguments: Sequence[str]) -> int:
    """Run a campaign from the command line."""
    if any(word.partition("=")[0] in ("--hours", "--page") for word in arguments):
        from campaigner.nightly import main as nightly

        return nightly(arguments)
    if "--properties" in arguments:
        from campaigner.properties import main as properties

        return properties(arguments)
    parser = _parser()
    args = parser.parse_args(arguments)
    args.seed = random.SystemRandom().randrange(1, 1_000_000) if args.seed is None else args.seed
    actions = _actions(parser, args)
    if args.list:
        print(*actions, sep="\n")
        return 0
    folder = Path(tempfile.mkdtemp(prefix="campaign-"))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # every way of ending it removes all processes
    campaign = Campaign(args, actions, folder)
    campaign.say(f"seed {args.seed}, {len(actions)} actions in {args.seconds:g} s; folder {folder}")
    with _own_folders(folder):
        try:
            code = campaign.run()
        except CanopenError as error:
            print(f"tools/campaign: {error}", file=sys.stderr)
            return 2
        finally:
            if not (campaign.found or args.keep):
                shutil.rmtree(folder, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
