"""Habits of manufacturers in EDS files, as own fragments: a drive with any of them boots with an ordinary bus.yml."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.vendor import ORDINARY, Booted, boot, dictionary, write_bus

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import CanopenError, SdoStopped
from canopen_control.frame import CanFrame
from canopen_control.master.config import read_bus
from canopen_control.master.requests import LETTERS
from canopen_control.od.model import DataType

RO = {"access": "ro"}


def plan_of(folder, od, node=ORDINARY, **how):
    config = read_bus(write_bus(folder, od, node, **how))
    return config.plans["drive"], config.notes


def written(plan, index):
    return [(write.subindex, write.data.hex()) for write in plan.writes if write.index == index]


def test_a_read_only_unit_of_the_interpolation_period_is_taken_as_it_is(tmp_path):
    plan, notes = plan_of(tmp_path, dictionary(s60C2_02=RO))
    assert written(plan, 0x60C2) == [(1, "14")]  # 20 * 10^-3 s, the EDS's own unit
    assert not [note for note in notes if "60C2" in note]
    assert boot(tmp_path, dictionary(s60C2_02=RO)).node.ready


def test_a_unit_finer_than_the_period_needs_is_filled_out(tmp_path):
    od = dictionary(s60C2_02={**RO, "default": -4})
    assert written(plan_of(tmp_path, od)[0], 0x60C2) == [(1, "c8")]  # 200 * 10^-4 s


@pytest.mark.parametrize(
    ("od", "words"),
    [
        (dictionary(s60C2_01=RO), "0x60C2:01"),
        (dictionary(s60C2_01=RO, s60C2_02=RO), "0x60C2:01"),
        (dictionary(s60C2_02={**RO, "default": -6}), "20000 us cannot be expressed in 10^-6 s"),
        (dictionary(s60C2_02={**RO, "default": None}), "an unknown unit"),
        (dictionary([(0x60C2, 2)]), "an unknown unit"),
    ],
)
def test_an_interpolation_period_that_cannot_be_set_is_done_without_and_reported(tmp_path, od, words):
    plan, notes = plan_of(tmp_path, od)
    assert written(plan, 0x60C2) == []
    reported = [note for note in notes if words in note]
    assert len(reported) == 1
    assert "not written" in reported[0]
    assert boot(tmp_path, od).node.ready


def test_what_bus_yml_names_itself_must_be_there_and_writable(tmp_path):
    node = f"{ORDINARY}sdo: [{{index: 0x60C2, sub_index: 2, value: -3}}]\n"
    with pytest.raises(CanopenError, match=r"0x60C2:02.* is ro, it cannot be written"):
        plan_of(tmp_path, dictionary(s60C2_02=RO), node)


def test_a_constant_heartbeat_is_watched_with_its_own_period(tmp_path):
    od = dictionary(s1017_00={"access": "const", "default": 50})
    node = ORDINARY.replace("heartbeat_producer: 100\n", "")
    plan, _ = plan_of(tmp_path, od, node)
    assert (written(plan, 0x1017), plan.heartbeat_timeout_ns) == ([], 150_000_000)
    assert boot(tmp_path, od, node).node.ready


def test_a_read_only_first_heartbeat_consumer_leaves_the_second(tmp_path):
    plan, _ = plan_of(tmp_path, dictionary(s1016_01=RO))
    assert [subindex for subindex, _ in written(plan, 0x1016)] == [2]


def test_a_drive_whose_heartbeat_consumer_cannot_be_set_is_not_supervised(tmp_path):
    od = dictionary([(0x1016, 2)], s1016_01=RO)
    with pytest.raises(CanopenError, match="nothing would stop this drive"):
        plan_of(tmp_path, od)
    plan, notes = plan_of(tmp_path, od, f"{ORDINARY}allow_unsupervised: true\n")
    assert written(plan, 0x1016) == []
    assert any("0x1016:01" in note and "not written" in note for note in notes)


def test_a_read_only_reaction_to_a_lost_master_leaves_the_error_behaviour(tmp_path):
    plan, notes = plan_of(tmp_path, dictionary(s6007_00=RO))  # its default is a fault already
    assert written(plan, 0x1029) == []
    assert not [note for note in notes if "6007" in note]
    od = dictionary(s6007_00={**RO, "default": 0})  # no reaction, for ever: whether 0x1029 stops it is the maker's word
    with pytest.raises(CanopenError, match="0x6007 = 0 lets the motor continue to turn"):
        plan_of(tmp_path, od)
    plan, _ = plan_of(tmp_path, od, f"{ORDINARY}allow_unsupervised: true\n")
    assert written(plan, 0x1029) == [(1, "02")]


def test_a_sync_counter_is_not_set_where_it_cannot_be(tmp_path):
    master = "{node_id: 1, sync_period: 20000, sync_overflow: 10}"
    plan, notes = plan_of(tmp_path, dictionary(s1019_00=RO), master=master)
    assert written(plan, 0x1019) == []
    assert any("0x1019:00" in note for note in notes)


@pytest.mark.parametrize("subs", [(2, 3, 4), (1, 2, 3, 4), (3, 4)])
def test_vendor_and_product_are_expected_only_where_0x1018_has_them(tmp_path, subs):
    od = dictionary([(0x1018, sub) for sub in subs], s1018_00={"default": 4 - len(subs)})
    od.device = type(od.device)(vendor_number=0x99, product_number=0x1234, product_name="terse")
    booted = boot(tmp_path, od)
    assert booted.node.ready, booted.collected
    identity = booted.node.plan.identity
    assert (identity.vendor_id, identity.product_code) == (0 if 1 in subs else 0x99, 0 if 2 in subs else 0x1234)


@pytest.mark.parametrize("high", [65535, 1000])
def test_a_limit_that_leaves_no_room_for_the_node_id_in_0x1016_is_not_obeyed(tmp_path, high):
    od = dictionary(s1016_01={"low": 0, "high": high}, s1016_02={"low": 0, "high": high})
    booted = boot(tmp_path, od)
    assert booted.node.ready, booted.collected
    assert booted.device.get(0x1016, 1) == 1 << 16 | 300
    assert not [note for note in booted.config.notes if "1016" in note]


def test_a_limit_of_a_cob_id_that_forbids_to_switch_the_pdo_off_is_not_obeyed(tmp_path):
    limits = {"low": 0x181, "high": 0x57F}
    assert boot(tmp_path, dictionary(s1400_01=limits, s1800_01=limits)).node.ready


def test_a_limit_of_a_quantity_counts(tmp_path):
    od = dictionary(s1017_00={"low": 0, "high": 60})
    booted = Booted(write_bus(tmp_path, od))
    assert any("0x1017:00" in note and "outside the limits" in note for note in booted.config.notes)
    assert not booted.run(2000).node.ready
    assert any("1017" in text for text in booted.collected)


@pytest.mark.parametrize("default", [None, 0])
def test_a_drive_whose_eds_gives_no_modes_is_asked_for_them(tmp_path, default):
    booted = boot(tmp_path, dictionary(s6502_00={"default": default}))
    assert booted.node.ready
    assert booted.node.identity.supported_modes == 0x3EF


def test_a_drive_without_the_object_reports_no_modes_and_boots(tmp_path):
    booted = boot(tmp_path, dictionary([0x6502]))
    assert booted.node.ready
    assert booted.node.identity.supported_modes is None


@pytest.mark.parametrize("number", [0, 1])
def test_the_concise_dcf_of_another_generator_which_writes_bit_30_as_0_is_taken(tmp_path, number):
    """dcfgen turns ``cob_id: auto`` into the predefined COB-ID alone, whatever bit 30 of the EDS says."""
    rtr = {
        f"s{base + number:04X}_01": {"default": 0x40000000 | first + 0x100 * number}
        for base, first in ((0x1400, 0x205), (0x1800, 0x185))
    }
    booted = Booted(write_bus(tmp_path, dictionary(**rtr)))
    for base, cob_id in ((0x1400, 0x205), (0x1800, 0x185)):
        for value in (cob_id + 0x100 * number | 1 << 31, cob_id + 0x100 * number):
            request = b"\x23" + (base + number).to_bytes(2, "little") + b"\x01" + value.to_bytes(4, "little")
            booted.device.tick(booted.now)
            booted.device.frames()
            booted.device.receive(CanFrame(0x605, request), booted.now)
            assert [frame.data[0] for frame in booted.device.frames() if frame.can_id == 0x585] == [0x60]
    assert booted.run(3000).node.ready, booted.collected


def test_the_dictionary_of_these_tests_is_the_file_that_was_read(tmp_path):
    od = dictionary(s60C2_02=RO)
    assert od[0x60C2, 2].data_type is DataType.INTEGER8
    assert Booted(write_bus(tmp_path, od)).device.od[0x60C2, 2].access == "ro"


# --- answers of the wrong length


def one_byte_for(booted, index, times=100):
    """Let the drive answer one byte for an object, whatever it holds."""
    upload, left = booted.device.store.upload, [times]

    def short(at, sub):
        data = upload(at, sub)
        if at == index and left[0]:
            left[0] -= 1
            return data[:1]
        return data

    booted.device.store.upload = short
    return booted


@pytest.mark.sources
@pytest.mark.parametrize(
    ("index", "letter", "words"),
    [
        (0x1000, "B", "device type 0x1000:00 not read: answered 1 byte (92), UNSIGNED32 has 4"),
        (0x1018, "B", "reading 0x1018:01: answered 1 byte (99), UNSIGNED32 has 4"),
        (0x6041, "J", "reading 0x6041:00: answered 1 byte (50), UNSIGNED16 has 2"),
        (0x6502, "J", "reading 0x6502:00: answered 1 byte (ef), UNSIGNED32 has 4"),
    ],
)
def test_an_answer_that_is_not_a_value_of_its_object_fails_the_boot_with_a_sentence(tmp_path, index, letter, words):
    booted = one_byte_for(Booted(write_bus(tmp_path, dictionary())), index).run(900)
    assert not booted.node.ready
    assert booted.collected == [f"node 5 (drive): boot error {letter}: {LETTERS[letter]}: {words}"]


@pytest.mark.sources
def test_a_setting_that_is_answered_with_another_length_is_reported_and_written_again(tmp_path):
    booted = one_byte_for(Booted(write_bus(tmp_path, dictionary())), 0x1017).run(2000)
    assert booted.node.ready
    assert any("0x1017:00: answered 1 byte (00), UNSIGNED16 has 2" in text for text in booted.collected)
    assert booted.device.get(0x1017) == 100


# --- what counts as a failure


def test_what_a_drive_has_not_is_not_a_failed_transfer(tmp_path):
    od = dictionary([(0x1018, 3), (0x1018, 4), 0x6502, 0x6061], s1018_00={"default": 2})
    node = ORDINARY.replace(", {index: 0x6061}", "")
    booted = boot(tmp_path, od, node)
    assert booted.node.ready, booted.collected
    assert booted.node.sdo_failed == 0


def test_a_node_in_stopped_is_reported_to_be_there(tmp_path):
    booted, ended = boot(tmp_path, dictionary()), []
    booted.node.command(NmtCommand.STOP, booted.now)
    for _ in range(200):
        booted.step()
    assert booted.node.nmt_state is NmtState.STOPPED
    booted.node.read(0x1000, 0, lambda request: ended.append(request.error))
    for _ in range(8000):
        booted.step()
    assert [type(error) for error in ended] == [SdoStopped]
    assert "NMT STOPPED" in str(ended[0])


# --- any EDS: the robot that is configured from it boots the drive that is made from it

SERVICES = [
    (0x1003,),
    (0x100C,),
    (0x100D,),
    (0x1010,),
    (0x1011,),
    (0x1015,),
    (0x1019,),
    (0x1029,),
    (0x6007,),
    (0x603F,),
]
SUBS = [(0x1016, 2), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4), (0x60C2, 1), (0x60C2, 2), (0x6502, 0)]
CHANGED = ["1005_00", "1016_02", "1017_00", "1019_00", "1029_01", "6007_00", "60C2_01", "60C2_02", "6502_00"]
COB_IDS = ["1400_01", "1401_01", "1800_01", "1801_01"]


@st.composite
def habits(draw):
    absent = [
        item if len(item) == 2 else item[0] for item in draw(st.sets(st.sampled_from(SERVICES + SUBS), max_size=6))
    ]
    fields = {}
    for name in draw(st.sets(st.sampled_from(CHANGED), max_size=5)):
        fields[name] = draw(
            st.sampled_from([{"access": "ro"}, {"access": "const"}, {"default": None}, {**RO, "default": 0}])
        )
    for name in draw(st.sets(st.sampled_from(COB_IDS))):
        flags = draw(st.sampled_from([0, 1 << 30, 1 << 31, 3 << 30]))
        base = {"1400": 0x205, "1401": 0x305, "1800": 0x185, "1801": 0x285}[name[:4]]
        fields[name] = {
            "default": draw(st.sampled_from([None, base | flags, flags])),
            "access": draw(st.sampled_from(["rw", "ro"])),
        }
        if fields[name]["access"] == "ro":
            fields[name]["default"] = base
    if draw(st.booleans()):
        fields["1016_01"] = {"low": 0, "high": draw(st.sampled_from([65535, 1000, 0xFFFFFFFF]))}
    present = {name: change for name, change in fields.items() if not _gone(name, absent)}
    return absent, {f"s{name}": change for name, change in present.items()}


def _gone(name, absent):
    index, sub = int(name[:4], 16), int(name[5:], 16)
    return index in absent or (index, sub) in absent


@settings(max_examples=examples(25), suppress_health_check=list(HealthCheck))
@given(habits())
def test_whatever_the_eds_specifies_its_own_virtual_drive_boots(tmp_path_factory, habits):
    absent, changes = habits
    node = ORDINARY.replace("heartbeat_producer: 100\n", "") + "allow_unsupervised: true\n"
    booted = boot(tmp_path_factory.mktemp("eds"), dictionary(absent, **changes), node)
    assert booted.node.ready, (booted.collected, booted.config.notes)
