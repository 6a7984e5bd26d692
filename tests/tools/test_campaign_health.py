"""Checks of the campaign apart from the bus: memory, output, and surviving processes."""

import pytest
from campaigner.health import GROWTH_MB, WARM_UP_S, Logs, Memory


def test_memory_that_grows_after_the_warm_up_is_a_breach_once():
    memory = Memory()
    assert memory.look(WARM_UP_S - 1, 500.0, 0.0) is None
    assert memory.look(WARM_UP_S + 1, 30.0, 1.0) is None
    assert memory.look(WARM_UP_S + 2, 30.0 + GROWTH_MB, 2.0) is None
    assert memory.look(WARM_UP_S + 3, None, 3.0) is None
    breach = memory.look(WARM_UP_S + 4, 30.1 + GROWTH_MB, 4.0)
    assert breach is not None
    assert (breach.time, breach.rule) == (4.0, "memory")
    assert memory.look(WARM_UP_S + 5, 90.0, 5.0) is None
    assert memory.growth == 60.0
    assert Memory().growth == 0.0


@pytest.mark.parametrize(
    "words", ["Traceback (most recent call last):\n  File", "canopen-control: a fault of this program, X"]
)
def test_a_traceback_is_reported_once_with_the_file(tmp_path, words):
    path, logs = tmp_path / "run.out", Logs()
    path.write_text("all is well\n")
    assert logs.look([path], 0.0) == []
    with path.open("a") as file:
        file.write(f"{words}\n")
    (breach,) = logs.look([path], 1.0)
    assert breach.rule == "traceback"
    assert breach.text.startswith("run.out: ")
    assert logs.look([path], 2.0) == []
