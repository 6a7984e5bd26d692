"""Inputs of the options that a job declares: what its verb takes as arguments, a page takes here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import ui

if TYPE_CHECKING:
    from canopen_control.commissioning.jobs import Job, JobOption


class JobForm:
    """Inputs of a job in the current container, by the names of its options: a checkbox for a switch, else a text."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self.inputs = {name: _input(option) for name, option in job.declared.items()}

    def options(self, **others: object) -> Any:  # noqa: ANN401 - of the job's own type
        """Return the options, with `others` that are not declared; ConfigError for an invalid input."""
        values = {
            name: bool(widget.value) if option.is_switch else option.value_of(str(widget.value or ""))
            for (name, option), widget in zip(self._job.declared.items(), self.inputs.values(), strict=True)
        }
        return self._job.options(**values, **others)


def _input(option: JobOption) -> ui.checkbox | ui.input:
    if option.is_switch:
        return ui.checkbox(option.text, value=option.default).props("dense")
    label = f"{option.text} (several with commas)" if option.repeats else option.text
    value = "" if option.repeats or option.default is None else str(option.default)
    return ui.input(label, value=value).props("dense").style("width: 100%")
