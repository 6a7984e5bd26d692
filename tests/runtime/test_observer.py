"""Calls from a robot to its observers."""

from support.observers import Observer
from support.robots import Bench


def test_each_observer_gets_every_event_and_the_start_and_the_end_once():
    bench, calls = Bench("observed"), []
    for name in ("one", "other"):
        bench.robot.observers.append(
            Observer(
                event=lambda event, name=name: calls.append((name, event.kind)),
                booted=lambda name=name: calls.append((name, "BOOTED")),
                running=lambda name=name: calls.append((name, "RUNS")),
                stopped=lambda name=name: calls.append((name, "ENDED")),
            )
        )
    bench.start()
    bench.robot.shutdown("the test ends")
    bench.run(3000)
    bench.close()
    of = {name: [kind for each, kind in calls if each == name] for name in ("one", "other")}
    assert of["one"] == of["other"]
    assert [kind for kind in of["one"] if kind in ("BOOTED", "running", "RUNS", "stopped", "ENDED")] == [
        "BOOTED",
        "running",
        "RUNS",
        "stopped",
        "ENDED",
    ]
