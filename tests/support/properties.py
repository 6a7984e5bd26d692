"""How many examples hypothesis tries, and whether it draws the same ones each time.

Tests run with examples derived from each test's code, so that every run tries the same ones, and keep no database of
them. `tools/campaign --properties` sets CANOPEN_CONTROL_EXAMPLES to a factor: then examples are drawn from a seed, and
there are that many times more of them. It also runs the tests marked `sweep` with all their values: `some_of` returns
few of them elsewhere.
"""

import os

from hypothesis import HealthCheck, settings

FACTOR = os.environ.get("CANOPEN_CONTROL_EXAMPLES")
#: Fraction of a test's examples that a run without a seed uses; fewer with the compiled package, since the pure-Python
#: run tests the same property.
#: the sources pass the same property.
SHARE = float(os.environ.get("CANOPEN_CONTROL_EXAMPLES_SHARE", "0.25"))


def examples(count):
    """Return how many examples this run tries where a campaign of factor 1 tries `count`."""
    return max(1, round(count * (float(FACTOR) if FACTOR else SHARE)))


def some_of(values, count=3):
    """Return all values where a campaign runs, else `count` of them, evenly spread."""
    values = list(values)
    return values if FACTOR else [values[at * len(values) // count] for at in range(count)]


def load_profile():
    settings.register_profile(
        "tests",
        max_examples=examples(100),
        derandomize=not FACTOR,
        database=None,
        deadline=None,  # other tests share these CPUs; pytest's timeout ends a test that hangs
        print_blob=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
    settings.load_profile("tests")
