"""Result of one check of the conformance suite."""

from canopen_control.conformance.run import CHECKS, run_checks


def verdict(node, check_id):
    report = run_checks(node, [check for check in CHECKS if check.id == check_id])
    return report.results[0].verdict
