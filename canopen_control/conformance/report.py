"""Reports of a conformance run: lines for a terminal, JUnit XML for CI, a comparison with an older run, one HTML page.

The self-contained page is for users, manufacturers and maintainers of a device. Its summary lists the consequences for
a master. Then follow a verdict per clause, the failures with their decoded frames, the problems of the EDS, and the
list of what was not tested.
"""

from __future__ import annotations

import re
from html import escape
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as Xml

from canopen_control.cia301.abort import abort_text
from canopen_control.conformance.check import clause_names
from canopen_control.conformance.run import ERROR, FAILED, PASSED, SKIPPED
from canopen_control.frame import Service, service_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.conformance.run import CheckResult, ConformanceReport


_CONTROL = re.compile(r"[^\t\n\r\x20-\uD7FF\uE000-\uFFFD\U00010000-\U0010FFFF]")  # characters forbidden in XML 1.0


def report_lines(report: ConformanceReport) -> Iterator[str]:
    """Yield lines for the failures and notes, then the number of results by verdict."""
    for result in report.results:
        if result.verdict in (FAILED, ERROR):
            yield f"{result.id} {result.verdict} ({result.level}, CiA {result.group} {result.clause}): {result.title}"
            yield f"    observed: {result.observed}" + (f"; expected: {result.expected}" if result.expected else "")
        for note in result.notes:
            yield f"{result.id}: {note}"
    counts = ", ".join(f"{report.count(verdict)} {verdict}" for verdict in ("passed", FAILED, SKIPPED, ERROR))
    yield f"{report.name}: {len(report.results)} checks: {counts}"


def junit(report: ConformanceReport) -> bytes:
    """Return JUnit XML in pytest's xunit2 form; a failed recommendation is output text, not a failure."""
    failures = [result for result in report.results if result.verdict == FAILED and result.level == "must"]
    counts = {
        "tests": str(len(report.results)),
        "failures": str(len(failures)),
        "errors": str(report.count(ERROR)),
        "skipped": str(report.count(SKIPPED)),
        "time": f"{sum(result.seconds for result in report.results):.3f}",
    }
    root = Xml.Element("testsuites", counts)
    suite = Xml.SubElement(root, "testsuite", {"name": _suite(report), **counts})
    properties = Xml.SubElement(suite, "properties")
    for name, value in report.identity.items():
        Xml.SubElement(properties, "property", {"name": name, "value": _legal(value)})
    for result in report.results:
        _case(suite, _suite(report), result)
    text: bytes = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def _suite(report: ConformanceReport) -> str:
    return f"canopen.node{report.node_id}" + ("" if report.subject == "device" else f".{report.subject}")


def _case(suite: Xml.Element, suite_name: str, result: CheckResult) -> None:
    name = f"{result.id} {result.title}"
    attributes = {
        "classname": f"{suite_name}.cia{result.group}",
        "name": name,
        "time": f"{result.seconds:.3f}",
    }
    case = Xml.SubElement(suite, "testcase", attributes)
    text = _legal(f"observed: {result.observed}; expected: {result.expected}; CiA {result.group} {result.clause}")
    frames = _legal("\n".join(result.frames))
    if result.verdict == SKIPPED:
        Xml.SubElement(case, "skipped", {"message": _legal(result.observed)})
    elif result.verdict == ERROR:
        Xml.SubElement(case, "error", {"message": _legal(result.observed), "type": "NotTested"})
    elif result.verdict == FAILED and result.level == "must":
        Xml.SubElement(case, "failure", {"message": text, "type": "CheckFailed"}).text = frames
    elif result.verdict == FAILED:
        Xml.SubElement(case, "system-out").text = f"recommendation not kept: {text}\n{frames}"


def _legal(text: str) -> str:
    return _CONTROL.sub("?", text)


def changed_verdicts(report: ConformanceReport, old: Mapping[str, str]) -> list[str]:
    """Return a line for each check whose verdict differs from an older run; `old` maps check ids to verdicts."""
    lines = []
    now = {result.id: result for result in report.results}
    for check_id, result in now.items():
        before = old.get(check_id, "not run")
        if before != result.verdict:
            lines.append(f"{check_id} ({result.title}): {before} -> {result.verdict}")
    lines += [f"{check_id}: {verdict} -> not run" for check_id, verdict in old.items() if check_id not in now]
    return lines


class Deviation(NamedTuple):
    """Quirk of virtual drives, the check that detects it, and the bus.yml key that compensates for it ("" if none)."""

    quirk: str
    check: str
    bus_key: str = ""


DEVIATIONS = (
    Deviation("sdo_after_boot", "N09", "boot_time"),
    Deviation("sdo_late", "S27t"),
    Deviation("sdo_stale", "N12"),
    Deviation("sdo_four_bytes", "S01s"),
    Deviation("sdo_size_unsaid", "S01s"),
    Deviation("sdo_garbage", "S01u"),
    Deviation("sdo_more_bytes", "S14"),
    Deviation("sdo_acknowledges_with_data", "S02u"),
    Deviation("sdo_short_frames", "S01l"),
    Deviation("sdo_aborts_general", "S06c"),
    Deviation("sdo_aborts_zero", "S05"),
    Deviation("sdo_no_block", "S17y"),
    Deviation("storing_silent", "R02t"),
    Deviation("mapping_fixed", "P11"),
    Deviation("mapping_in_preop", "P16o"),
    Deviation("mapping_short", "P11m"),
    Deviation("cob_id_fixed", "P05"),
    Deviation("cob_ids_of_node", "P01d", "cob_id"),
    Deviation("foreign_pdo_unmappable", "P16f"),
    Deviation("mapping_swapped", "P02d"),
    Deviation("tpdo_by_event", "P21t"),
    Deviation("inhibit_time", "P20n"),
    Deviation("length_error_8220", "P17e"),
    Deviation("boot_delay", "N08", "boot_time"),
    Deviation("boot_unsaid", "N01"),
    Deviation("already_operational", "N10"),
    Deviation("start_without_errors", "N13"),
    Deviation("start_after_boot", "N11"),
    Deviation("heartbeat_absent", "H00"),
    Deviation("heartbeat_at_start", "H02d"),
    Deviation("consumer_rounded", "H03r"),
    Deviation("consumer_refused", "H03r"),
    Deviation("sync_counter_absent", "Y05e"),
    Deviation("emcy_own_register", "M09"),
    Deviation("emcy_own_data", "M09"),
    Deviation("emcy_zeros_at_boot", "M08"),
    Deviation("modes_listed_without", "D12"),
    Deviation("modes_not_listed", "D02"),
    Deviation("own_velocity_mode", "D12n", "velocity_mode"),
    Deviation("own_torque_mode", "D12n", "effort_mode"),
    Deviation("own_position_mode", "D12n", "position_mode"),
    Deviation("one_mode", "D11"),
    Deviation("mode_shown_late", "D11", "mode_timeout_ms"),
    Deviation("mode_display_zero_until_enabled", "D11"),
    Deviation("mode_display_late", "D11t", "mode_timeout_ms"),
    Deviation("mode_fixed_while_halted", "D68h"),
    Deviation("mode_fixed_while_enabled", "D68e", "switching_state"),
    Deviation("enable_needs_mode", "D46"),
    Deviation("enable_delay", "D23t", "transition_timeouts_ms"),
    Deviation("switch_on_delay", "D22t", "transition_timeouts_ms"),
    Deviation("link_empty_after_fault", "D38e", "transition_timeouts_ms"),
    Deviation("transition_slow", "D21t", "transition_timeout_ms"),
    Deviation("not_ready_time", "D20t", "transition_timeout_ms"),
    Deviation("quick_stop_ends_switched_on", "D30"),
    Deviation("quick_stop_unseen", "D30"),
    Deviation("quick_stop_off", "D30"),
    Deviation("fault_reset_twice", "D36"),
    Deviation("fault_reset_slow", "D36t", "fault_reset_timeout_ms"),
    Deviation("fault_reset_level", "D36t", "fault_reset_timeout_ms"),
    Deviation("fault_reaction_endless", "D35"),
    Deviation("enable_faults", "D23"),
    Deviation("enabled_in_preop", "D42"),
    Deviation("remote_when_enabled", "D08", "ignore_remote"),
    Deviation("remote_never", "D08", "ignore_remote"),
    Deviation("voltage_never", "D23v"),
    Deviation("warning_always", "D08w"),
    Deviation("internal_limit_always", "D08l"),
    Deviation("own_bits_change", "D08m"),
    Deviation("controlword_write_only", "D03"),
    Deviation("period_refused", "D15p"),
    Deviation("period_rounded", "D15p"),
    Deviation("parameter_clamped", "D13"),
    Deviation("homing_zero_late", "D65z"),
    Deviation("homing_zero_refused", "D65m"),
    Deviation("homing_method_fixed", "D65w"),
    Deviation("set_point_needs_bit_5", "D54"),
    Deviation("target_reached_inverted", "D56"),
    Deviation("error_code_absent", "D093f"),
    Deviation("velocity_shown_zero", "D51"),
    Deviation("velocity_absent", "D096c"),
    Deviation("brake_delay", "D23m"),
    Deviation("mode_fixed_while_moving", "D68m"),
    Deviation("first_enable_faults", "D20e"),
    Deviation("quick_stop_resumes", "D31m"),
    Deviation("mains_awaited", "D44v"),
    Deviation("fault_returns", "D37"),
    Deviation("inputs_shifted", "D07"),
    Deviation("set_points_elsewhere", "D43m"),
    Deviation("polarity_of_targets", "D51p"),
    Deviation("one_ramp", "D50d"),
    Deviation("own_velocity_unit", "D15v"),
    Deviation("own_ramp_unit", "D50"),
    Deviation("target_reached_flickers", "D56m"),
    Deviation("set_point_alone", "D55s"),
    Deviation("one_set_point", "D55b"),
    Deviation("acknowledged_at_enable", "D54e"),
    Deviation("homing_latched", "D66"),
    Deviation("homing_shown_briefly", "D65k"),
    Deviation("homing_without_bit_12", "D65"),
    Deviation("homing_without_bit_10", "D65"),
    Deviation("homes_without_power", "D65o"),
    Deviation("homing_ignores_halt", "D66h"),
    Deviation("no_phase_lock", "D58j"),
    Deviation("extrapolates", "D59e"),
    Deviation("set_points_supervised", "D59m"),
    Deviation("rpdo_late", "D58r"),
    Deviation("record_position", "D58i"),
    Deviation("torque_then_position", "D68t"),
    Deviation("sync_period_judged", "D60s"),
    Deviation("cob_id_not_stored", "R02c"),
    Deviation("emcy_at_boot", "M08"),
    Deviation("heartbeats_at_boot", "H02b"),
    Deviation("mapped_not_written", "S30"),
    Deviation("sdo_first_lost", "S31"),
    Deviation("optional_missing", "D093f"),
)
"""Quirks and the checks that detect them; a check may not be able to distinguish between several quirks."""

# Consequence of a failure for a master, by the first section or object of the clause that has an entry.
_MEANINGS = (
    ("7.2.4", "A master that configures the device by SDO will see refused or wrong transfers."),
    (
        "7.3.2",
        "A master that boots and starts the device will wait for it, repeat its commands, or report a boot error.",
    ),
    ("7.2.8", "A master that supervises the device will see false losses of it, or miss a real one."),
    ("7.5.2.19", "The device may not notice that its master is gone: test its reaction to a lost master."),
    ("7.5.2.20", "A master that supervises heartbeats will see false losses of the device, or miss a real one."),
    ("7.5.2.12", "A master cannot rely on the reaction of the device when the guarding ends."),
    ("7.2.5", "A master that sends SYNC with a counter, or at another period, will not be followed exactly."),
    ("0x1005", "A master that moves or generates SYNC can configure an identifier that disturbs the bus."),
    ("0x1006", "A master that sets the period of SYNC may find another period in the device."),
    ("0x1019", "A master cannot use the SYNC counter, nor spread process data over several cycles."),
    ("7.2.7", "A master that shows EMCY messages will show a wrong cause, or none."),
    ("7.5.2.4", "A master that reads the error history (0x1003) will show errors that did not occur, or miss errors."),
    ("7.5.2.2", "A master that relies on the error register (0x1001) will miss a class of errors."),
    ("7.5.2.13", "Parameters that were stored may be gone after a power-on: configure the device at every boot."),
    ("7.5.2.14", "The device may not return to its defaults: restore its parameters from a file."),
    ("7.5.2.23", "A master that relies on 0x1020 may skip the configuration of a changed device."),
    ("7.5.2.35", "A master that sets up process data may have to use the COB-IDs and types of the device."),
    ("7.5.2.36", "A master that maps process data may have to use the mapping of the device."),
    ("7.5.2.37", "A master that relies on the times of TPDOs will receive them less often, or at other times."),
    ("7.2.2", "A master that sends RPDOs of another length, or too early, may change other values than intended."),
    ("7.3.5", "A wrong configuration can assign an identifier that other nodes need: check the identifiers first."),
    ("7.4.7", "The EDS does not belong to the device: obtain the right EDS before you configure the device."),
    ("7.5", "A tool that identifies the device by its objects will not recognise it."),
    (
        "302",
        "A master that starts, configures or updates the device by CiA 302 may fail: test this before you rely on it.",
    ),
    ("306", "A tool that configures the device by its EDS may write wrong values, or map the wrong objects."),
    ("305", "A master that assigns node-IDs by LSS will not find the device, or will find another device."),
    ("0x605A", "An emergency stop by quick stop will not end as configured: use the hardware stop, and test it."),
    ("0x6060", "A master that changes modes during motion will have to wait, or be refused."),
    ("0x6061", "A master that waits for the mode display will time out, or send set-points in the wrong mode."),
    ("0x6502", "A master that reads the supported modes will offer the wrong modes."),
    ("0x6041", "A master that evaluates the bits of the statusword will refuse to enable the drive, or warn."),
    ("0x6040", "A master that reads the controlword back cannot check what it commanded."),
    ("0x6098", "A master that sets up homing will be refused."),
    ("0x60C2", "Cyclic motion will be uneven: the drive interpolates over another time than the master's cycle."),
    ("0x6083", "A master that computes the time of a motion from the ramps will be wrong."),
    ("0x6084", "A master that computes the stopping distance from 0x6084 will be wrong: leave a margin."),
    (
        "0x607E",
        "A master that reverses a joint by 0x607E will close its loop with the wrong sign: reverse it in software.",
    ),
    ("0x60A9", "The unit of velocity must be configured in the master: no object defines it."),
    ("0x607D", "A master cannot rely on the limits of the drive: set limits of its own."),
    ("0x60FD", "A master that reads the limit switches will find them in other bits."),
    ("11", "A master that waits for the end of homing will time out, or consider a drive homed that is not."),
    ("12", "Cyclic motion may be uneven, or end in a fault if a cycle of the master is late."),
    ("13", "The drive does not follow cyclic velocities of a master."),
    ("14", "A master that sends cyclic torques cannot rely on the limit 0x6072."),
    (
        "10",
        "A master that moves the drive by profile positions will wait for bit 12 or 10, or see them too early.",
    ),
    ("6.3", "A master that enables the drive will wait longer than usual, or report a failed transition."),
    ("402", "A master that relies on this object of the profile will not get what it expects."),
)
_OF_MASTER = {  # key: first two letters of the ids of the checks of a master
    "MC": "A device may run with another configuration than this master intends.",
    "MN": "A device may miss an NMT command of this master, or stay in another state than it assumes.",
    "MT": "A device with a strict SDO server will refuse requests of this master, or get a wrong value.",
    "MG": "A guarded device may count this master as lost.",
    "MH": "A device that supervises this master by its heartbeat will stop, or will not notice its end.",
    "MY": "A drive that interpolates between SYNCs will move unevenly, or not at all.",
    "MP": "A device will ignore process data of this master, or report them as errors.",
    "MW": "A drive may not be enabled, or be enabled unexpectedly.",
    "MF": "After a fault of a device this master continues, or the drive starts again without a command.",
}
_STYLE = """body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:62em;padding:0 1em;color:#1b1b1b}
table{border-collapse:collapse;width:100%}td,th{border:1px solid #bbb;padding:.25em .5em;text-align:left;
vertical-align:top}th{background:#eee}pre{background:#f4f4f4;padding:.6em;overflow:auto}.passed{color:#176117}
.failed,.error{color:#a11212;font-weight:600}.skipped{color:#666}.should{color:#8a5a00;font-weight:600}"""
_ORDER = (ERROR, FAILED, PASSED, SKIPPED)


def html_page(report: ConformanceReport, does: Mapping[str, str], issues: Iterable[str] = ()) -> str:
    """Return the HTML page; `does` maps each quirk to its description, `issues` are the issues of the EDS."""
    failures = [result for result in report.results if result.verdict in (FAILED, ERROR)]
    title = f"Conformance of {report.name}"
    identity = ", ".join(f"{name} 0x{value}" for name, value in report.identity.items())
    parts = (
        f"<h1>{title}</h1><p>{escape(identity)}</p>",
        _summary(report, failures, does),
        _clauses(report.results),
        _failures(failures, does),
        _section("Problems of the EDS", _list(issues)) if issues else "",
        _section("Not tested", _list(_untested(report.results))),
    )
    body = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>\n<body>{body}</body></html>\n"
    )


def _section(title: str, content: str) -> str:
    return f"<h2>{title}</h2>\n{content}" if content else ""


def _list(lines: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(line)}</li>\n" for line in lines)
    return f"<ul>\n{items}</ul>" if items else ""


def _class(result: CheckResult) -> str:
    return "should" if result.verdict == FAILED and result.level == "should" else result.verdict


def _summary(report: ConformanceReport, failures: list[CheckResult], does: Mapping[str, str]) -> str:
    musts = [result for result in failures if result.level == "must"]
    counts = ", ".join(f"{report.count(verdict)} {verdict}" for verdict in (PASSED, FAILED, SKIPPED, ERROR))
    verdict = f"{len(musts)} mandatory checks failed" if musts else "No mandatory check failed"
    meanings = dict.fromkeys(meaning_of(result) for result in sorted(failures, key=lambda one: one.level != "must"))
    keys = sorted({one.bus_key for result in failures for one in deviations_of(result, does) if one.bus_key})
    advice = f"<p>Keys of bus.yml that compensate for some failures: {', '.join(map(_code, keys))}.</p>" if keys else ""
    text = f"<p><b>{verdict}.</b> {len(report.results)} checks: {counts}.</p>"
    return _section("Summary for a buyer", text + _list(meanings) + advice)


def _code(text: str) -> str:
    return f"<code>{escape(text)}</code>"


def meaning_of(result: CheckResult) -> str:
    """Return the consequence of a device's failure for a master, or of a master's failure for its devices."""
    if result.id[:2] in _OF_MASTER:
        return _OF_MASTER[result.id[:2]]
    names = {*clause_names(result.clause), result.group}
    for section, text in _MEANINGS:
        if any(name == section or name.startswith(section + ".") for name in names):
            return text
    return f"A master that counts on clause {result.clause} will not get what it expects."


def deviations_of(result: CheckResult, does: Mapping[str, str]) -> list[Deviation]:
    """Return the quirks that a failed check indicates and that `does` describes."""
    return [one for one in DEVIATIONS if one.check == result.id and one.quirk in does]


def _clauses(results: Iterable[CheckResult]) -> str:
    clauses: dict[tuple[str, str], list[CheckResult]] = {}
    for result in results:
        clauses.setdefault((result.group, result.clause), []).append(result)
    rows = []
    for (group, clause), members in sorted(clauses.items()):
        worst = min(members, key=lambda one: (_ORDER.index(one.verdict), one.level != "must"))
        word = "recommendation not kept" if _class(worst) == "should" else worst.verdict
        ids = ", ".join(f'<span class="{_class(one)}">{escape(one.id)}</span>' for one in members)
        name = clause.partition(", ")[2] if clause.startswith(group) else clause
        rows.append(
            f'<tr><td>CiA {group}</td><td>{escape(name)}</td><td class="{_class(worst)}">{word}</td><td>{ids}</td>'
        )
    head = "<tr><th>Document</th><th>Clause</th><th>Verdict</th><th>Checks</th></tr>"
    return _section("Verdict per clause", f"<table>{head}\n" + "</tr>\n".join(rows) + "</tr></table>")


def _failures(failures: Iterable[CheckResult], does: Mapping[str, str]) -> str:
    parts = []
    for result in failures:
        frames = escape("\n".join(f"{line}   {frame_name(line)}" for line in result.frames))
        rows = "".join(
            f"<p>Known as the quirk {_code(one.quirk)}: {escape(does[one.quirk])}."
            + (f" Key of bus.yml: {_code(one.bus_key)}." if one.bus_key else "")
            + "</p>"
            for one in deviations_of(result, does)
        )
        parts.append(
            f'<h3 class="{_class(result)}">{escape(result.id)}: {escape(result.title)}</h3>'
            f"<p>{result.level}, CiA {result.group}, {escape(result.clause)}. Observed: {escape(result.observed)}."
            f" Expected: {escape(result.expected)}.</p>{rows}" + (f"<pre>{frames}</pre>" if frames else "")
        )
    return _section("Failures", "\n".join(parts))


def _untested(results: Iterable[CheckResult]) -> list[str]:
    return [f"{result.id}, {result.title}: {result.observed}" for result in results if result.verdict == SKIPPED]


def frame_name(line: str) -> str:
    """Return the name of a logged frame, such as "SDO request: upload of 0x1000:00", or ""."""
    _time, _direction, identifier, *data = line.split()
    service = service_of(int(identifier, 16))
    if service is None:
        return ""
    kind, node_id = service
    octets = bytes(int(byte, 16) for byte in data)
    if kind in (Service.SDO_CLIENT, Service.SDO_SERVER) and len(octets) == 8:
        return _sdo_name(octets, answer=kind is Service.SDO_SERVER)
    return kind.name.replace("_", " ") + (f" of node {node_id}" if node_id else "")


def _sdo_name(octets: bytes, *, answer: bool) -> str:
    index, command = f"0x{int.from_bytes(octets[1:3], 'little'):04X}:{octets[3]:02X}", octets[0] & 0xE0
    prefix = "SDO answer" if answer else "SDO request"
    if octets[0] == 0x80:
        code = int.from_bytes(octets[4:], "little")
        return f"{prefix}: abort of {index}, 0x{code:08X} ({abort_text(code)})"
    if command == 0x40:
        return f"{prefix}: upload of {index}"
    if command == (0x60 if answer else 0x20):
        return f"{prefix}: download to {index}"
    return prefix
