"""Reports of a conformance run: lines for a terminal, JUnit XML for CI, and a comparison with an older run."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from xml.etree import ElementTree as Xml

from canopen_control.conformance.run import ERROR, FAILED, SKIPPED

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
