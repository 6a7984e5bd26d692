"""Tune tab, where the user starts a tuning run within confirmed limits and applies the resulting gains."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from canopen_control.client import RobotClient
from canopen_control.commissioning import tune_job as jobs
from canopen_control.commissioning.jobs import TUNE, JobRun
from canopen_control.commissioning.quantity import Quantity
from canopen_control.commissioning.tune_run import TuneTest
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.health import BAD
from canopen_control.view.drive.drive_tab import READ_ONLY_NOTE, JobForm, WorkBar
from canopen_control.view.elements.nicegui_elements import PresenceElement
from canopen_control.view.panels.panel import Html, section
from canopen_control.view.scope_chart import BODE_HEIGHT, bode_options, chart_options, height_of
from canopen_control.view.words import sentence

if TYPE_CHECKING:
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.scope_chart import Options


_TIMEOUT_S: Final = 2.0
_PROPOSAL: Final = ("crossover", "phase_margin", "loop_delay")
_WARNING: Final = (
    "The drive starts to move at once, within these limits. Free the shaft or lift the wheels, stay clear, have the "
    "hardware emergency stop within reach. STOP, Abort, a limit, a fault and closing this page end the motion."
)
_TESTS: Final = {
    TuneTest.STEP.name: "step response",
    TuneTest.BODE.name: "frequency response",
    TuneTest.IDENTIFY.name: "identify inertia and friction",
}
_APPLY: Final = (
    "The previous gains are saved so that you can revert. New gains are verified, and are lost at power-off unless "
    "stored. Nothing is set while the drive is enabled."
)


class TuneTab:
    """Tab that starts tuning runs for a node, and shows the latest result, no matter which page started the run."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._node_jobs = context, context.node_jobs
        self._here = jobs.PagePresence()
        self._drawn: jobs.TuneFound | None = None
        self._is_own_run = False
        self._period = 0.01
        self._confirmed: jobs.TunePlan | None = None
        with ui.element("div").classes("cc-tab-columns"):
            with section("Excitation"):
                self._make_form()
            with section("Limits"):
                self._make_limits()
            with section("Gains"):
                self._make_gains()
        with section("Now"):
            self._refused = Html()
            self._bar = WorkBar(self._node_jobs, TUNE.tab)
            self._lines = Html("cc-wide")
        with ui.element("section").classes("cc-panel") as self._picture:
            self._chart = ui.echart({}).classes("cc-scope-chart")
            self._bode = ui.echart({}).classes("cc-scope-chart")
        self._picture.visible = self._bode.visible = False
        self._presence = PresenceElement(self._here.here)
        self._make_dialog()
        self._arrange()

    def _make_form(self) -> None:
        axes = {number: f"{number}: {joint}" for number, joint in enumerate(self._context.place.joints)} or {0: "0"}
        self._axis = ui.select(axes, value=0, label="axis").props("dense options-dense").style("width: 100%")
        self._axis.visible = len(axes) > 1
        self._test = ui.select(_TESTS, value=TuneTest.STEP.name, label="test").props("dense options-dense")
        self._test.on_value_change(lambda _event: self._arrange()).style("width: 100%")
        with ui.element("div").classes("cc-row cc-wish"):
            self._speed = ui.number("to, rad/s", value=3.0, step=0.5).props("dense")
            self._torque = ui.number("torque, per mille", value=150.0, min=1.0, max=300.0, step=10.0).props("dense")
            self._signal = ui.select(["chirp", "prbs"], value="chirp", label="signal").props("dense options-dense")
        self._form = JobForm(TUNE, ("seconds", *_PROPOSAL))

    def _make_limits(self) -> None:
        self._form.add("max_speed", "max_travel", "max_current")
        if not self._context.panel.teleop:
            ui.html(READ_ONLY_NOTE, sanitize=False)
        self._no_run = Html()
        with ui.element("div").classes("cc-row cc-acts"):
            self._run = ui.button("Run ...", color="orange-9", on_click=self._ask).props("unelevated dense")

    def _make_gains(self) -> None:
        ui.html(f"<p class='cc-note'>{_APPLY}</p>", sanitize=False)
        self._form.add("counts", "store")
        self._no_gains = Html()
        with ui.element("div").classes("cc-row cc-acts"):
            self._apply = ui.button("Set the gains", color="orange-9", on_click=self._begin_apply)
            self._revert = ui.button("Revert", color="blue-grey-8", on_click=self._begin_revert)
            for button in (self._apply, self._revert):
                button.props("unelevated dense")

    def _make_dialog(self) -> None:
        with ui.dialog() as self._dialog, ui.card():
            self._words = Html()
            with ui.element("div").classes("cc-row cc-acts"):
                ui.button("Start the motion", color="orange-9", on_click=self._begin).props("unelevated no-caps")
                ui.button("Cancel", color="blue-grey-8", on_click=self._dialog.close).props("outline no-caps")

    def _arrange(self) -> None:
        """Show the inputs needed by the chosen test."""
        test = TuneTest[str(self._test.value)]
        self._speed.visible = test is TuneTest.STEP
        self._signal.visible = test is TuneTest.BODE
        for widget in (self._torque, *(self._form.inputs[name] for name in _PROPOSAL)):
            widget.visible = test is TuneTest.IDENTIFY

    # ------------------------------------------------------------------------------------ calls of the frame

    def show(self, content: PageContent) -> None:
        self._period = content.state.cycle.period_s or self._period
        self._bar.show()
        free = not content.lost and not self._node_jobs.busy and self._context.panel.teleop
        tuned = self._node_jobs.tuned
        no_run = self._why_not(content)
        no_gains = self._why_no_gains(content)
        self._run.set_enabled(free and not no_run)
        self._revert.set_enabled(free and not no_gains)
        self._apply.set_enabled(free and not no_gains and tuned is not None and tuned.gains is not None)
        self._no_run.show(sentence(no_run))
        self._no_gains.show(sentence(no_gains))
        if self._is_own_run and not self._node_jobs.busy:
            self._is_own_run = False
            self._presence.switch(on=False)
        if tuned is not None and tuned is not self._drawn and tuned.lines and not self._node_jobs.busy:
            self._drawn = tuned
            self._draw(tuned)

    def _why_not(self, content: PageContent) -> str:
        if content.lost:
            return ""  # the banner shows this already
        if content.state.latched:
            return "STOP is latched: release it before a drive is moved."
        return jobs.refusal(content.controllers, self._context.place, int(self._axis.value), self._node_jobs.robot)

    def _why_no_gains(self, content: PageContent) -> str:
        reading = self._context.reading(content)
        on = [axis.joint for axis in reading.axes if axis.enabled] if reading is not None else []
        return f"Gains cannot be set in an enabled drive; disable {', '.join(on)} first." if on else ""

    def leave(self) -> None:
        """End a run that this page has started, because the tab is hidden."""
        work = self._node_jobs.work
        if self._is_own_run and work is not None and work.job is TUNE:
            work.end()
        self._is_own_run = False
        self._presence.switch(on=False)

    # ------------------------------------------------------------------------------------ what the user does

    def _plan(self) -> jobs.TunePlan:
        """Return the plan of a run from the inputs; raise ConfigError if an input is invalid or exceeds a limit."""
        options = self._form.options(axis=int(self._axis.value))
        request = jobs.request_of(
            TuneTest[str(self._test.value)],
            options,
            self._period,
            speed=Quantity(float(self._speed.value or 0.0), "rad/s", "velocity"),
            torque=float(self._torque.value or 0.0),
            signal=str(self._signal.value),
        )
        return jobs.TunePlan.of(request, options, jobs.SCALE)

    @property
    def _moved(self) -> str:
        """Name of the node that would move, with the axis if it has several."""
        return f"{self._context.node}, axis {self._axis.value}" if self._axis.visible else self._context.node

    def _ask(self) -> None:
        """Open the dialog in which the user confirms the motion."""
        if not self._context.panel.teleop:
            return
        try:
            plan = self._plan()
        except ConfigError as error:
            self._refused.show(sentence(str(error), BAD))
            return
        self._refused.show("")
        words = "".join(f"<p class='cc-line'>{escape(line)}</p>" for line in plan.lines(jobs.SCALE))
        self._words.show(f"<p class='cc-ask'>Move {escape(self._moved)}?</p>{words}<p class='cc-note'>{_WARNING}</p>")
        self._confirmed = plan
        self._dialog.open()

    def _begin(self) -> None:
        """Start the run that the user has confirmed; later changes of the inputs have no effect."""
        self._dialog.close()
        plan, self._confirmed = self._confirmed, None
        if plan is None or not self._context.panel.teleop:
            return
        result = jobs.TuneFound(plan)
        self._here.here()
        here = self._here

        def run(session: NodeSession, work: JobRun) -> str:
            with RobotClient.connect(self._node_jobs.robot, _TIMEOUT_S) as client:
                text = jobs.tune(session, work, client, result, here)
            self._node_jobs.tuned = result
            return text

        self._is_own_run = self._start("Tuning", "hundredths of a second", run)
        self._presence.switch(on=self._is_own_run)

    def _begin_apply(self) -> None:
        tuned = self._node_jobs.tuned
        if not self._context.panel.teleop or tuned is None or tuned.gains is None:
            return
        try:
            options = self._form.options(axis=tuned.plan.axis)
        except ConfigError as error:
            self._refused.show(sentence(str(error), BAD))
            return
        if options.counts is None:
            self._refused.show(sentence("enter the counts per revolution of the joint (position units of 0x6064)", BAD))
            return
        apply = partial(
            jobs.apply_gains, gains=tuned.gains, counts=options.counts, axis=options.axis, stores=options.store
        )
        self._start("Setting gains", "objects", apply)

    def _begin_revert(self) -> None:
        if self._context.panel.teleop:
            revert = partial(jobs.revert, axis=int(self._axis.value), stores=bool(self._form.inputs["store"].value))
            self._start("Reverting gains", "objects", revert)

    def _start(self, title: str, unit: str, function: Any) -> bool:  # noqa: ANN401 - takes a session and the work
        refused = self._node_jobs.begin(JobRun(TUNE, f"{title} of {self._context.node}", unit), function)
        self._refused.show("" if refused is None else sentence(refused, BAD))
        self._bar.show()
        return refused is None

    def _draw(self, result: jobs.TuneFound) -> None:
        self._lines.show(f"<pre class='cc-found'>{escape(chr(10).join(result.lines))}</pre>")
        self._picture.visible = result.curves is not None
        if result.curves is not None:
            self._fill(self._chart, chart_options(result.curves, None, None), height_of(result.curves))
        self._bode.visible = result.bode is not None
        if result.bode is not None:
            self._fill(self._bode, bode_options(result.bode), BODE_HEIGHT)

    def _fill(self, chart: ui.echart, options: Options, height: int) -> None:
        chart.style(f"height: {height}px")
        chart.options.clear()
        chart.options.update(options)
        chart.update()
