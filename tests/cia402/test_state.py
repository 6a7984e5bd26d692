from __future__ import annotations

import json
from pathlib import Path

import pytest

from canopen_control.cia402.state import (
    FAULT_RESET_BIT,
    STATUSWORD_MASKS,
    TRANSITIONS,
    Command,
    State,
    command_of,
    controlword_of,
    decode_statusword,
    next_command,
    transition_of,
)

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "cia402.json").read_text())
STATUSWORDS, CONTROLWORDS = VECTORS["cia402_statusword"], VECTORS["cia402_controlword"]
LADDER = [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED]


def test_every_statusword_decodes_as_the_mask_table_of_the_vectors_reports():
    table = [(int(row["mask"], 16), int(row["value"], 16), row["state"]) for row in STATUSWORDS["mask_table"]]
    decoded = 0
    for word in range(0x10000):
        names = [name for mask, value, name in table if (word ^ value) & mask == 0]
        state = decode_statusword(word)
        assert [state.name] * len(names) == names if state else not names, hex(word)
        decoded += state is not None
    assert decoded == 12_288


def test_masks_and_values_are_those_of_the_vectors():
    rows = {row["state"]: (int(row["mask"], 16), int(row["value"], 16)) for row in STATUSWORDS["mask_table"]}
    assert {state.name: (mask, state.value) for state, mask in STATUSWORD_MASKS.items()} == rows


def test_every_pattern_of_the_six_state_bits_is_as_listed():
    for bits, name in STATUSWORDS["all_patterns_of_bits_6_5_3_2_1_0"].items():
        state = decode_statusword(int(bits, 16))
        assert (state.name if state else None) == name


def test_wider_or_negative_ints_decode_by_their_low_bits():
    assert decode_statusword(0x10237) is State.OPERATION_ENABLED
    assert decode_statusword(-1) is None


def test_commands_have_the_masks_and_words_of_the_vectors():
    for name, row in CONTROLWORDS["commands"].items():
        assert Command[name].value == (int(row["mask"], 16), int(row["value"], 16))
        assert controlword_of(Command[name]) == int(row["write"], 16)


@pytest.mark.parametrize("example", CONTROLWORDS["decode_examples"], ids=lambda example: example["cw"])
def test_controlwords_decode_to_the_command_of_the_vectors(example):
    command = command_of(int(example["cw"], 16), int(example["prev"], 16))
    name = example["command"].removesuffix("(edge)").split("/")[0]
    assert command is Command[name]


def test_every_controlword_without_bit_7_is_exactly_one_command():
    for word in range(0x10000):
        if not word & FAULT_RESET_BIT:
            command = command_of(word, 0)
            assert command is not None
            mask, bits = command.value
            assert word & mask == bits


def test_fault_reset_is_the_rising_edge_and_not_the_level():
    assert command_of(0x80, 0x00) is Command.FAULT_RESET
    assert command_of(0x8F, 0x0F) is Command.FAULT_RESET
    assert command_of(0x80, 0x80) is None
    assert command_of(0x8F, 0x80) is None
    assert command_of(0x0F, 0x8F) is Command.ENABLE_OPERATION


def test_names_of_one_pattern_are_one_command():
    assert Command.SWITCH_ON is Command.DISABLE_OPERATION
    assert Command.ENABLE_OPERATION is Command.SWITCH_ON_AND_ENABLE


@pytest.mark.parametrize("row", CONTROLWORDS["transitions"], ids=lambda row: str(row["no"]))
def test_transitions_are_those_of_the_vectors(row):
    transition = TRANSITIONS[row["no"]]
    assert transition.number == row["no"]
    assert transition.target.name == row["to"]
    commands = {Command[name] for name in row["command"].split("|")} if row["command"] else set()
    assert set(transition.commands) == commands
    if row["from"] == "START":
        assert transition.sources == ()
    elif row["from"] == "ANY":
        assert set(transition.sources) == set(State) - {State.FAULT_REACTION_ACTIVE, State.FAULT}
    else:
        assert [state.name for state in transition.sources] == [row["from"]]
    if row["write"]:
        assert transition_of(transition.sources[0], command_of(int(row["write"], 16), 0)) is transition


def test_the_way_up_is_the_enable_sequence_of_the_vectors():
    for row in CONTROLWORDS["enable_sequence"][1:]:
        command = next_command(State[row["when"]], State.OPERATION_ENABLED)
        assert [f"0x{controlword_of(command):04X}"] == row["write"]


@pytest.mark.parametrize("goal", [*LADDER, State.QUICK_STOP_ACTIVE])
def test_following_next_command_reaches_the_goal_from_every_state_and_stays(goal):
    for start in [*LADDER, State.QUICK_STOP_ACTIVE]:
        state = start
        for _ in range(6):
            transition = transition_of(state, next_command(state, goal))
            state = transition.target if transition else state
        reached = {goal, State.SWITCH_ON_DISABLED} if goal is State.QUICK_STOP_ACTIVE else {goal}
        if goal in LADDER[:3]:  # downwards only: what starts lower stays there
            reached = set(LADDER[: LADDER.index(goal) + 1])
        assert state in reached


@pytest.mark.parametrize("goal", [*LADDER[:3], State.QUICK_STOP_ACTIVE])
def test_no_goal_but_operation_enabled_ever_goes_up_or_sends_0x0f(goal):
    for state in [*LADDER, State.QUICK_STOP_ACTIVE]:
        command = next_command(state, goal)
        assert command is not Command.ENABLE_OPERATION
        transition = transition_of(state, command)
        if transition and state in LADDER and transition.target in LADDER:
            assert LADDER.index(transition.target) < LADDER.index(state)


def test_nothing_is_commanded_in_a_fault_at_start_or_towards_what_is_not_a_goal():
    for state in (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE, State.FAULT):
        assert next_command(state, State.OPERATION_ENABLED) is None
    assert next_command(State.SWITCHED_ON, State.FAULT) is None
