"""Form for the options that a job declares, which are also options of the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import ui

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.commissioning.jobs import Job, JobOption


class JobForm:
    """Inputs for the options of a job, a checkbox for a switch and a text field for all others.

    The inputs for `names`, by default for all options, are created in the current container; `add` creates more.
    """

    def __init__(self, job: Job, names: Iterable[str] | None = None) -> None:
        self._job = job
        self.inputs: dict[str, ui.checkbox | ui.input] = {}
        self.add(*(job.declared if names is None else names))

    def add(self, *names: str) -> None:
        """Create the inputs of further options in the current container."""
        declared = self._job.declared
        self.inputs |= {name: _input(declared[name]) for name in names}

    def options(self, **others: object) -> Any:  # noqa: ANN401 - of the job's own type
        """Return the options from the inputs and from `others`; ConfigError if an input is invalid."""
        declared = self._job.declared
        values = {
            name: bool(widget.value) if declared[name].is_switch else declared[name].value_of(str(widget.value or ""))
            for name, widget in self.inputs.items()
        }
        return self._job.options(**values, **others)


def _input(option: JobOption) -> ui.checkbox | ui.input:
    if option.is_switch:
        return ui.checkbox(option.text, value=option.default).props("dense")
    label = f"{option.text} (several with commas)" if option.repeats else option.text
    value = "" if option.repeats or option.default is None else f"{option.default}".removesuffix(".0")
    return ui.input(label, value=value).props("dense").style("width: 100%")
