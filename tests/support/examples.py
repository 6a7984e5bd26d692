"""The examples that users copy: of every verb's help, and the command lines of README.md and the pages of docs."""

from __future__ import annotations

import importlib
import re
import shlex

from support.documents import EXAMPLES, pages

from canopen_control.cli.verbs import VERBS

PROGRAM = "canopen-control"

#: Commands that need something that no test has here: the reason why they are only parsed, and where they run.
NOT_RUN = {
    r"\bcan\d+\b": "a CAN card: tests/hardware_can runs the page on emulated ones",
    r"\bvcan\d+\b": "a kernel with CAN: tests/socketcan runs the page on one",
    r"\budp_can:": "an adapter that is installed first: tests/docs/test_adapter_howto.py",
    r"^view --address": "a page that is open: tests/cli/test_view.py has one",
    r"--realtime": "a processor for itself: tests/runtime/test_realtime.py",
    r"^jog\b": "a drive on a bus of its own: tests/cli/test_jog.py has one",
    r"^tune\b": "a drive on a bus of its own: tests/cli/test_tune.py has one",
    r"^(firmware|nmt \w+) lift": "a robot of a drive with a boot-loader: tests/cli/test_firmware.py has such drives",
    r"^(firmware|fault) .*local:desk": "a drive with a boot-loader: tests/docs/test_firmware_page.py follows the page",
    r"^scope .*--trigger": "something that happens: tests/cli/test_scope.py waits for a fault",
    r"^trajectory\b": "an arm: tests/cli/test_trajectory.py has one",
    r"^device .*--status|\bdi\d=": "an I/O module beside the robot: tests/cli/test_device.py has one",
    r"--plant\b": "a plant file: tests/cli/test_drive.py and tests/virtual/test_worldfile_shaft.py have some",
    r"^gripper\b|--controller gripper\b": "a gripper: tests/cli/test_gripper.py has one",
    r"\bmecanum_base_controller\b": "a base that goes sideways: tests/cli/test_twist.py has one",
    r"^world \w": "a robot in physics: tests/cli/test_world.py has a world",
    r"^run --world\b": "a file that names robots: tests/runtime/test_shared_world.py has one",
    r"^command .*\bio/lamp=": "outputs: tests/cli/test_command.py has some",
    r" /outputs/commands ": "outputs and a bridge: tests/ros/test_command_topics_gpio_commands.py has what it sends",
    r"^calibrate\b": "a base that errs, and minutes of squares: tests/cli/test_calibrate.py has one",
    r"^replay .*--page": "a flight recording: tests/cli/test_replay.py has one",
    r"--plant floor\.yml": "a plant file: tests/integration/test_true_pose_of_a_run.py has one",
    r"^eds diff": "files that are equal: tests/cli/test_eds.py compares some that differ",
    r"^ros param set": "a base controller that is active: test_controller_nodes_parameter_services.py sets them",
    r"^ros bridge": "a robot without a bridge: tests/cli/test_ros.py starts one",
    r"^diff left_drive right_drive": "drives that no example before has written to: tests/cli/test_diff.py has two",
    r"^simulate .*--(serve|ros)\b": "minutes of real time: tests/simulation/test_served_simulation.py serves one",
    r"^bench\b": "minutes of measuring: tests/bench runs every family of it",
}
#: Other programs in code blocks of the pages: the reason why they are not run.
OTHER_PROGRAMS = {
    "./tools/demo": "installs what it needs: CI's first run of it is that of any user",
    "./tools/test": "runs this test",
    "./tools/docs": "builds the documentation, which CI does",
    "ros2": "ros2cli is not in the wheels; `canopen-control ros` says the same, and is run",
    "export": "of the shell, for ros2",
    "pip": "the index has the package once it is published",
    "tools/socketcan_guest": "boots a kernel: tools/test --rest does so",
    "tools/can_hardware_guest": "boots a computer: tools/test --rest does so",
}


def help_examples() -> dict[str, list[list[str]]]:
    """Return the examples of each verb in their order, as words after `canopen-control`."""
    examples = {}
    for verb in VERBS:
        lines = importlib.import_module(f"canopen_control.cli.{verb}").EXAMPLE.splitlines()
        examples[verb] = [words_of(line) for line in lines]
    return examples


def page_examples() -> list[list[str]]:
    """Return the pages' commands of this program, each once, as words after `canopen-control`."""
    lines = [tuple(words_of(line)) for line in page_commands() if line.split()[0] == PROGRAM]
    return [list(words) for words in dict.fromkeys(lines)]


def page_commands() -> list[str]:
    """Return every command line of the pages: what is indented and looks like one; their files as whole paths."""
    programs = "|".join(map(re.escape, (PROGRAM, *OTHER_PROGRAMS)))
    text = "\n".join(path.read_text(encoding="utf-8") for path in pages())
    result = re.findall(rf"^ {{4,}}((?:{programs})(?: .*)?)$", text, re.MULTILINE)
    return [line.replace(" docs/examples/", f" {EXAMPLES}/") for line in result]


def page_file(page: str, name: str) -> str:
    """Return the file that a page shows, a block whose first line is a comment with its name."""
    text = next(path.read_text(encoding="utf-8") for path in pages() if path.name == page)
    block = re.search(rf"^```\w+\n(# {re.escape(name)}\b.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert block is not None, f"{page} shows no {name}"
    return block[1]


def words_of(line: str) -> list[str]:
    """Return the words of an example, as a shell reads them, without the program's name."""
    program, *words = shlex.split(line.strip(), comments=True)
    assert program == PROGRAM, line
    return words


def reason_not_to_run(words: list[str]) -> str | None:
    """Return why an example is only understood here, or None."""
    return next((reason for pattern, reason in NOT_RUN.items() if re.search(pattern, " ".join(words))), None)
