"""Turns: what a measured program is told, and what it answers."""

import io
import json
import sys

from canopen_control_bench.turns import Turn, serve_turns


def orders(monkeypatch, capsys, *lines):
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(json.dumps(line) + "\n" for line in lines)))
    done = []
    serve_turns(lambda number: done.append(("cycle", number)), lambda: done.append(("wait",)))
    return done, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_free_turn_waits_for_the_answers_of_each_cycle(monkeypatch, capsys):
    done, said = orders(monkeypatch, capsys, {"cycles": 2, "period_ns": 0}, "end", {"cycles": 9, "period_ns": 0})
    assert done == [("cycle", 0), ("wait",), ("cycle", 1), ("wait",)]
    assert said[0] == {"ready": True}
    assert len(said) == 2
    turn = Turn(**said[1])
    assert (turn.cycles, turn.late_ns) == (2, [])
    assert turn.cpu_ns > 0


def test_a_paced_turn_measures_every_cycle(monkeypatch, capsys):
    done, said = orders(monkeypatch, capsys, {"cycles": 3, "period_ns": 1000})
    turn = Turn(**said[1])
    assert done == [("cycle", 0), ("cycle", 1), ("cycle", 2)]
    assert len(turn.late_ns) == len(turn.work_ns) == 3
    assert turn.wall_ns >= 3000


def test_cpu_is_told_for_each_cycle():
    assert Turn(cycles=4, cpu_ns=8000).cpu_us == 2.0
