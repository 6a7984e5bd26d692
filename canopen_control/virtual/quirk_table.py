"""Table of quirks of drives on the market: each a documented difference of a healthy drive from CiA 402.

A fault is what breaks, a quirk is how a manufacturer's drive always is. A row says its name, what the drive does, the
clause or object of the standard that it departs from ("" where the standard allows it), its source, and its strength
where it has one. A source is a repository with the number of a thread, a file of one, or a manual with its page or
object; `unsourced`: seen by users, no public source is known. A quirk is written ``NAME``, ``NAME=VALUE`` or, for one
axis of several, ``NAME=VALUE@AXIS``. Of two quirks of one `group` an axis can have one. Quirks that are faults of other
drives keep the names of those.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.rpc.messages.drive import QuirkListing
from canopen_control.virtual import quirk_acts as acts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.virtual.quirk_acts import AxisAct, NodeAct


@dataclass(frozen=True, slots=True)
class Strength:
    """Strength of a quirk: unit, default and bounds; `whole` for integers."""

    unit: str
    default: float
    low: float
    high: float
    whole: bool = False


def _s(default: float, high: float = 60.0) -> Strength:
    return Strength("s", default, 0.001, high)


def _n(unit: str, default: float, low: float, high: float) -> Strength:
    return Strength(unit, default, low, high, whole=True)


@dataclass(frozen=True, slots=True)
class Quirk:
    """Row of the table: `axis` acts on an axis, `node` on the node; exactly one of them is set."""

    name: str
    does: str
    clause: str
    source: str
    axis: AxisAct | None = None
    node: NodeAct | None = None
    strength: Strength | None = None
    group: str = ""

    def listing(self, on: Sequence[str] = ()) -> QuirkListing:
        """Return the row as a message; `on`: how the quirk is active."""
        strength = self.strength
        return QuirkListing(
            name=self.name,
            does=self.does,
            clause=self.clause,
            source=self.source,
            acts="axis" if self.axis is not None else "node",
            unit="" if strength is None else strength.unit,
            default=None if strength is None else strength.default,
            low=None if strength is None else strength.low,
            high=None if strength is None else strength.high,
            on=list(on),
        )


_POWER, _STATUS, _CONTROL = (
    "CiA 402-2, 6.3 (power state machine)",
    "CiA 402-2, object 0x6041",
    "CiA 402-2, object 0x6040",
)
_MODE, _SHOWN, _LISTED = "CiA 402-2, object 0x6060", "CiA 402-2, object 0x6061", "CiA 402-2, object 0x6502"
_QUICK, _PP, _HOMING = "CiA 402-2, object 0x605A", "CiA 402-2, 10 (profile position)", "CiA 402-2, 11 (homing)"
_PERIOD, _CYCLIC = "CiA 402-2, object 0x60C2", "CiA 402-2, 12 to 15 (cyclic modes)"
_SDO, _NMT, _EMCY = "CiA 301, 7.2.4.3 (SDO)", "CiA 301, 7.3.2 (NMT)", "CiA 301, 7.2.7 (EMCY)"
_MAPPING, _RECORD = "CiA 301, 7.5.2.36 and 7.5.2.38", "CiA 301, 7.5.2.35 and 7.5.2.37"
_CONSUMER, _STORE = "CiA 301, 7.5.2.19 (0x1016)", "CiA 301, 7.5.2.13 (0x1010)"
_IPOS_MODES = "yarp-devices: TechnosoftIpos, embedded-pid/IControlModeRawImpl.cpp"
_IPOS_MANUAL = "Technosoft, iPOS CANopen programming manual (2023)"
_KINCO = "CANOpenRobotController: KincoDrive.cpp"

_ROWS: Final = (
    # modes of operation
    Quirk(
        "modes_listed_without",
        "does not list in 0x6502 a mode that it has (the strength: its number)",
        _LISTED,
        f"{_IPOS_MANUAL}, 6502h; yarp-devices#222",
        acts.modes_listed_without,
        strength=_n("mode", 8, 1, 32),
        group="0x6502",
    ),
    Quirk(
        "modes_not_listed",
        "has no 0x6502",
        _LISTED,
        "ros_canopen#462",
        node=acts.supported_modes_absent,
        group="0x6502",
    ),
    Quirk(
        "own_velocity_mode",
        "has a velocity mode with a number of its manufacturer, which takes 0x60FF without a ramp",
        _MODE,
        "Kinco, FD5 manual, p. 190",
        acts.further_mode(OperationMode.CSV),
        strength=_n("mode", -3, -128, -1),
    ),
    Quirk(
        "own_torque_mode",
        "has a torque mode with a number of its manufacturer, which takes 0x6071",
        _MODE,
        _IPOS_MODES,
        acts.further_mode(OperationMode.CST),
        strength=_n("mode", -5, -128, -1),
    ),
    Quirk(
        "own_position_mode",
        "has a position mode with a number of its manufacturer, which takes 0x607A in cycles",
        _MODE,
        _IPOS_MODES,
        acts.further_mode(OperationMode.CSP),
        strength=_n("mode", -1, -128, -1),
    ),
    Quirk(
        "one_mode",
        "takes one mode alone (the strength: its number)",
        _MODE,
        "linuxcnc-ethercat#180 (Omron MX2)",
        acts.only_mode,
        strength=_n("mode", 2, 1, 10),
    ),
    Quirk(
        "mode_shown_late",
        "shows -1 in 0x6061 for a time after a change to a cyclic mode",
        _SHOWN,
        "ros_canopen#457 (Festo CMMP-AS)",
        acts.mode_shown_late,
        strength=_s(4.0),
    ),
    Quirk(
        "mode_display_zero_until_enabled",
        "shows 0 in 0x6061 until it is in OPERATION ENABLED",
        _SHOWN,
        "ros2_canopen#444",
        acts.mode_shown_enabled,
    ),
    Quirk("mode_display_late", "changes its mode late", _SHOWN, "unsourced", acts.mode_delay, strength=_s(0.2)),
    Quirk(
        "mode_fixed_while_halted",
        "changes no mode while the halt bit is set",
        _MODE,
        "ros2_canopen#234 (ENGEL HBI)",
        acts.mode_fixed_while_halted,
    ),
    Quirk(
        "mode_fixed_while_enabled",
        "changes its mode in SWITCH ON DISABLED and READY TO SWITCH ON alone",
        _MODE,
        "ros_canopen#259 (switching_state)",
        acts.mode_fixed_while_enabled,
    ),
    Quirk(
        "mode_fixed_while_moving",
        "changes its mode at standstill alone",
        _MODE,
        "unsourced",
        acts.mode_fixed_while_moving,
    ),
    Quirk(
        "enable_needs_mode",
        "does not enter OPERATION ENABLED while 0x6060 is 0",
        _POWER,
        "ros_canopen#331 (Nanotec)",
        acts.mode_needed,
    ),
    # the power state machine
    Quirk(
        "enable_delay",
        "shows OPERATION ENABLED a time after the command, when its brake has lifted",
        _POWER,
        "Beckhoff, MR3107, 8001:11; jsd#48",
        acts.enable_delay,
        strength=_s(0.5),
    ),
    Quirk(
        "brake_delay",
        "follows set-points a time after OPERATION ENABLED, when its brake has lifted",
        _POWER,
        "jsd#48 (Elmo: motor on, servo enabled)",
        acts.set_points_after_brake,
        strength=_s(0.5),
    ),
    Quirk(
        "switch_on_delay",
        "needs a time from READY TO SWITCH ON to SWITCHED ON, to load its DC link",
        _POWER,
        "Festo, CMMP-AS manual, p. 164",
        acts.switch_on_delay,
        strength=_s(6.0),
    ),
    Quirk(
        "link_empty_after_fault",
        "obeys no command for a time after a fault reset: its DC link is empty, bit 4 is 0",
        _POWER,
        "Festo, CMMP-AS manual, p. 164",
        acts.link_empty_after_fault,
        strength=_s(3.0),
    ),
    Quirk(
        "transition_slow",
        "needs a time for every transition",
        _POWER,
        "unsourced",
        acts.transition_delay,
        strength=_s(2.0),
    ),
    Quirk(
        "not_ready_time",
        "shows NOT READY TO SWITCH ON for a time after a reset",
        _POWER,
        "unsourced",
        acts.not_ready,
        strength=_s(4.0),
    ),
    Quirk(
        "mains_awaited",
        "falls from SWITCHED ON to SWITCH ON DISABLED after a time without main power",
        _POWER,
        "Toshiba, VF-S15 CANopen manual, p. 30",
        acts.mains_awaited,
        strength=_s(3.0),
    ),
    Quirk(
        "sto_switched_on",
        "falls from OPERATION ENABLED to SWITCHED ON when its power stage is switched off",
        _POWER,
        "fastcat#164 (Elmo)",
        acts.supply_loss_switched_on,
    ),
    Quirk(
        "quick_stop_ends_switched_on",
        "stands in SWITCHED ON after a quick stop",
        _POWER,
        "UDTStudio#4 (UniSwarm)",
        acts.quick_stop_ends_on,
        group="quick stop",
    ),
    Quirk(
        "quick_stop_unseen",
        "goes from OPERATION ENABLED to SWITCH ON DISABLED at once on a quick stop, without power",
        _QUICK,
        "canopen#167",
        acts.quick_stop_at_once,
        group="quick stop",
    ),
    Quirk(
        "quick_stop_off",
        "ignores the quick stop (0x605A = -1 of its manufacturer)",
        _QUICK,
        "Beckhoff, AX8xxx, object 605A",
        acts.quick_stop_off,
        group="quick stop",
    ),
    Quirk(
        "quick_stop_resumes",
        "is enabled from QUICK STOP ACTIVE by 0x0F, whatever 0x605A says",
        _QUICK,
        "jsd#93, #66 (Elmo)",
        acts.quick_stop_resumes,
    ),
    Quirk(
        "fault_reset_twice",
        "resets a fault by every second edge of bit 7",
        _POWER,
        "ros_canopen#138",
        acts.reset_by_second_edge,
        group="fault reset",
    ),
    Quirk(
        "fault_reset_slow",
        "leaves FAULT a time after the edge of bit 7",
        _POWER,
        "unsourced",
        acts.reset_takes,
        strength=_s(3.0),
        group="fault reset",
    ),
    Quirk(
        "fault_reset_level",
        "resets a fault when bit 7 has been 1 for a time",
        _POWER,
        "unsourced",
        acts.reset_by_level,
        strength=_s(1.0),
        group="fault reset",
    ),
    Quirk(
        "fault_returns",
        "leaves FAULT by a reset although its cause lasts, and faults again at once",
        _POWER,
        "yarp-devices#215 (iPOS)",
        acts.faults_again,
        group="fault reset",
    ),
    Quirk("fault_reaction_endless", "stays in FAULT REACTION ACTIVE", _POWER, "unsourced", acts.fault_reaction_endless),
    Quirk(
        "enable_faults",
        "answers an enable with FAULT while a precondition is missing (the strength: the EMCY code)",
        _POWER,
        "ros2_canopen#298 (Leadshine iSV2)",
        acts.enable_faults,
        strength=_n("EMCY code", 0x5201, 1, 0xFFFF),
        group="enable",
    ),
    Quirk(
        "first_enable_faults",
        "faults by the first enable after its start, and by no other (the strength: the EMCY code)",
        _POWER,
        "ethercat_driver_ros2#151, #87 (ZeroErr eRob)",
        acts.first_enable_faults,
        strength=_n("EMCY code", 0xFF00, 1, 0xFFFF),
        group="enable",
    ),
    Quirk(
        "torque_then_position",
        "faults with 0x8A00 when its mode changes from torque to CSP in operation",
        _MODE,
        "eRob_SOEM_linux#12 (ZeroErr eRob)",
        acts.torque_to_position_faults,
    ),
    Quirk(
        "enabled_in_preop",
        "is enabled in PRE-OPERATIONAL too, and takes set-points by SDO there",
        _POWER,
        "unsourced",
        node=acts.enabled_in_preop,
    ),
    Quirk(
        "sync_period_judged",
        "faults with 0x8700 in a cyclic mode unless 0x1006 is its interpolation time",
        "CiA 301, object 0x1006",
        "canfestival-rtt#18; canopen#407 (Delta ASDA-A2)",
        acts.sync_period_judged,
    ),
    # bits of the statusword
    Quirk(
        "remote_when_enabled",
        "sets bit 9 in OPERATION ENABLED alone",
        _STATUS,
        "SMC, LECSN-T manual, p. 871",
        acts.remote_enabled_only,
        group="bit 9",
    ),
    Quirk("remote_never", "never sets bit 9", _STATUS, "SMC, LECSN-T manual, p. 871", acts.remote_never, group="bit 9"),
    Quirk("voltage_never", "never sets bit 4", _STATUS, "SMC, LECSN-T manual, p. 871", acts.voltage_never),
    Quirk("warning_always", "always sets bit 7", _STATUS, "unsourced", acts.warning_always),
    Quirk("internal_limit_always", "always sets bit 11", _STATUS, "unsourced", acts.limit_always),
    Quirk(
        "own_bits_change",
        "changes bits 8 and 15 all the time",
        _STATUS,
        "Nanotec, NP5 manual, 6041h",
        acts.own_bits_flicker,
    ),
    Quirk(
        "target_reached_flickers",
        "sets and clears bit 10 during a motion in PP",
        _PP,
        "yarp-devices#245 (iPOS)",
        acts.reached_flickers,
        group="bit 10",
    ),
    Quirk(
        "target_reached_inverted",
        "clears bit 10 at the target in PP, and sets it before",
        _PP,
        "unsourced",
        acts.reached_inverted,
        group="bit 10",
    ),
    Quirk(
        "controlword_write_only",
        "refuses to read 0x6040",
        _CONTROL,
        "ros_canopen#377 (Applied Motion)",
        acts.control_unreadable,
    ),
    # set-points and motion
    Quirk(
        "set_point_alone",
        "takes a new set-point of PP only when the one before is reached",
        _PP,
        "a NuttX driver of the ZLAC8015D (position start, target flag)",
        acts.set_point_alone,
        group="PP",
    ),
    Quirk(
        "set_point_needs_bit_5", "takes a new set-point of PP with bit 5 alone", _PP, _KINCO, acts.set_point_needs_bit_5
    ),
    Quirk(
        "one_set_point",
        "knows no buffered set-points in PP: a new one replaces the one under way, bit 12 shows that",
        _PP,
        "Trinamic, TMCM-1270 manual",
        acts.one_set_point,
        group="PP",
    ),
    Quirk(
        "set_points_elsewhere",
        "takes its set-points from another source than the bus: enabled, it does not move",
        _CONTROL,
        "Vacon/H-Max frequency converters: a project's plan (START SRC)",
        acts.never_moves,
    ),
    Quirk(
        "no_phase_lock",
        "stands at the end of a set-point, and takes each SYNC as the exact time",
        _CYCLIC,
        "ros2_canopen#236 (EPOS4)",
        acts.stands_without_phase_lock,
        group="missing set-point",
    ),
    Quirk(
        "extrapolates",
        "goes on for some interpolation times without a set-point, then it stands",
        _CYCLIC,
        "unsourced",
        acts.goes_on,
        strength=_n("cycles", 1, 1, 255),
        group="missing set-point",
    ),
    Quirk(
        "set_points_supervised",
        "goes on for some interpolation times without a set-point, then it faults with 0xFF02",
        _CYCLIC,
        "jsd#66, #93 (Elmo, 0x2F75)",
        acts.faults_without_set_points,
        strength=_n("cycles", 1, 1, 255),
        group="missing set-point",
    ),
    Quirk(
        "record_position",
        "takes the position of IP from another subindex of 0x60C1 (the strength)",
        "CiA 402-2, object 0x60C1",
        "ros_canopen#307 (Kollmorgen RGM)",
        acts.record_position,
        strength=_n("subindex", 2, 2, 8),
    ),
    Quirk("period_refused", "refuses to write 0x60C2", _PERIOD, "unsourced", acts.period_refused, group="0x60C2"),
    Quirk(
        "period_rounded",
        "rounds 0x60C2 down to a multiple, silently",
        _PERIOD,
        "unsourced",
        acts.period_rounded,
        strength=_n("ms", 8, 1, 250),
        group="0x60C2",
    ),
    Quirk(
        "polarity_of_targets",
        "turns targets alone round by 0x607E, and not the feedback",
        "CiA 402-2, object 0x607E",
        "a public header of an EtherCAT driver for Elmo",
        acts.polarity_of_targets,
    ),
    Quirk(
        "one_ramp",
        "uses 0x6083 in PV both ways",
        "CiA 402-2, object 0x6084",
        "Trinamic, TMCM-1270 manual",
        acts.one_ramp,
    ),
    Quirk(
        "own_velocity_unit",
        "has a velocity unit that no object names (the strength: counts/s of one unit)",
        "CiA 402-2, object 0x60A9",
        "Kinco, FD5 manual, p. 190 (512 x resolution / 1875 of a rpm)",
        acts.velocity_unit,
        strength=Strength("counts/s", 10.0, 1e-6, 1e6),
    ),
    Quirk(
        "parameter_clamped",
        "takes at most so much for 0x6083, silently",
        "CiA 402-2, object 0x6083",
        "unsourced",
        node=acts.ceiling,
        strength=_n("units", 1000, 1, 0xFFFFFFFF),
    ),
    Quirk(
        "inputs_shifted",
        "shows its switches in higher bits of 0x60FD",
        "CiA 402-2, object 0x60FD",
        "linuxcnc-ethercat: leadshine_stepper.md",
        acts.inputs_shifted,
        strength=_n("bits", 4, 1, 12),
    ),
    # homing
    Quirk(
        "homing_latched",
        "keeps bit 12 of homing until operation is left",
        _HOMING,
        "aidin_hand2: header of the homing sequence",
        acts.homing_latched,
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_shown_briefly",
        "shows bit 12 of homing for a time alone",
        _HOMING,
        "unsourced",
        acts.homing_shown_for,
        strength=_s(0.05),
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_without_bit_12",
        "shows the end of homing by bit 10 alone",
        _HOMING,
        "unsourced",
        acts.homing_without_bit_12,
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_without_bit_10",
        "never sets bit 10 in homing",
        _HOMING,
        "ros2_canopen#245 (JVL MIS)",
        acts.homing_without_bit_10,
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_zero_refused",
        "refuses homing method 0",
        "CiA 402-2, object 0x6098",
        "ros2_canopen#328 (Faulhaber)",
        acts.homing_zero_refused,
    ),
    Quirk(
        "homing_method_fixed",
        "refuses to write 0x6098 in OPERATION ENABLED",
        "CiA 402-2, object 0x6098",
        "unsourced",
        acts.homing_method_fixed,
    ),
    Quirk(
        "homes_without_power",
        "takes its position for home by methods 35 and 37 in every state",
        _HOMING,
        "Trinamic, TMCM-1270 manual",
        acts.homes_without_power,
    ),
    Quirk(
        "homing_ignores_halt",
        "goes on homing when the halt bit is set",
        _HOMING,
        "Trinamic, TMCM-1270 manual",
        acts.homing_goes_on_halted,
    ),
    # SDO
    Quirk(
        "sdo_after_boot",
        "answers SDO requests a time after its boot-up message",
        _NMT,
        "canopen#401 (Nanotec CL4-E)",
        node=acts.sdo_after_boot,
        strength=_s(2.0),
    ),
    Quirk("sdo_late", "answers SDO requests late", _SDO, "unsourced", node=acts.sdo_takes, strength=_s(0.1, 10.0)),
    Quirk(
        "sdo_first_lost",
        "does not answer the first SDO request after its boot-up",
        _SDO,
        "ros_canopen#347",
        node=acts.first_request_lost,
    ),
    Quirk(
        "mapped_not_written",
        "refuses SDO downloads to objects that an RPDO brings, while it is OPERATIONAL",
        _SDO,
        "SOEM#567 (STF06-EC)",
        node=acts.mapped_not_written,
    ),
    Quirk(
        "sdo_stale",
        "answers old requests after its boot-up, with EMCY 0x8110",
        _NMT,
        "ros2_canopen#36 (Ingenia)",
        node=acts.stale_answers,
    ),
    Quirk(
        "sdo_four_bytes",
        "answers expedited uploads of every size with 4 bytes",
        _SDO,
        "canopen#395",
        node=acts.four_bytes,
        group="size of uploads",
    ),
    Quirk(
        "sdo_size_unsaid",
        "does not say the size of expedited uploads (0x42)",
        _SDO,
        "espp#762",
        node=acts.size_unsaid,
        group="size of uploads",
    ),
    Quirk(
        "sdo_garbage",
        "leaves garbage behind the value of expedited uploads",
        _SDO,
        "ros_canopen#259",
        node=acts.garbage_behind,
        group="size of uploads",
    ),
    Quirk(
        "sdo_more_bytes",
        "sends more bytes in the last segment than it announced",
        _SDO,
        "ros_canopen: canopen_master/src/sdo.cpp (Elmo)",
        node=acts.more_bytes,
    ),
    Quirk(
        "sdo_acknowledges_with_data",
        "repeats data in the answer to a download",
        _SDO,
        "unsourced",
        node=acts.acknowledged_with_data,
    ),
    Quirk(
        "sdo_short_frames",
        "answers with frames of less than 8 bytes",
        _SDO,
        "unsourced",
        node=acts.short_answers,
        group="size of uploads",
    ),
    Quirk(
        "sdo_aborts_general",
        "aborts with 0x08000000 whatever the reason is",
        _SDO,
        "unsourced",
        node=acts.aborts_general,
        group="abort codes",
    ),
    Quirk("sdo_aborts_zero", "aborts with the code 0", _SDO, "unsourced", node=acts.aborts_zero, group="abort codes"),
    Quirk("sdo_no_block", "knows no block transfer", _SDO, "unsourced", node=acts.no_block),
    Quirk(
        "optional_missing",
        "lacks 0x603F, 0x6007 and 0x60C2",
        "CiA 402-2, objects 0x603F, 0x6007 and 0x60C2",
        "unsourced",
        node=acts.optional_missing,
    ),
    Quirk(
        "error_code_absent",
        "has no 0x603F; the EMCY has the error code",
        "CiA 402-2, object 0x603F",
        _KINCO,
        node=acts.error_code_absent,
    ),
    Quirk("velocity_absent", "has no 0x606C", "CiA 402-2, object 0x606C", "unsourced", node=acts.velocity_absent),
    Quirk(
        "storing_silent",
        "hears and sends nothing for a time while it stores parameters",
        _STORE,
        "unsourced",
        node=acts.storing_takes,
        strength=_s(4.0),
    ),
    # process data
    Quirk(
        "mapping_count_first",
        "refuses mapping entries with 0x06010000 unless the count is 0",
        "",
        "canopen#3 (Copley)",
        node=acts.mapping_count_first,
    ),
    Quirk(
        "mapping_fixed",
        "has a PDO mapping that cannot be written",
        _MAPPING,
        "unsourced",
        node=acts.mapping_fixed,
    ),
    Quirk(
        "mapping_in_preop",
        "takes PDO records in PRE-OPERATIONAL alone",
        _MAPPING,
        f"ros_canopen#425 (Schneider LXM28A); {_KINCO}",
        node=acts.mapping_in_preop,
    ),
    Quirk(
        "mapping_short",
        "takes few objects in a PDO",
        _MAPPING,
        "linuxcnc-ethercat#512, #343 (Inovance)",
        node=acts.mapping_short,
        strength=_n("objects", 2, 1, 8),
    ),
    Quirk(
        "cob_id_fixed",
        "has COB-IDs of PDOs that cannot be written, not even bit 31; their mapping can",
        _RECORD,
        "ros_canopen#151 (Elmo)",
        node=acts.cob_ids_fixed,
        group="COB-ID",
    ),
    Quirk(
        "cob_id_not_stored",
        "does not store the COB-IDs of PDOs by 0x1010",
        _STORE,
        "c-open#51",
        node=acts.cob_ids_not_stored,
    ),
    Quirk(
        "cob_ids_of_node",
        "starts with the COB-IDs of another node (the strength: its id)",
        _RECORD,
        "maxon_epos4_ros1; canopen#317",
        node=acts.cob_ids_of,
        strength=_n("node id", 1, 1, 127),
        group="COB-ID",
    ),
    Quirk(
        "foreign_pdo_unmappable",
        "refuses a mapping with 0x06040041 while the COB-ID is another node's",
        _MAPPING,
        "maxon_epos4_ros1#1 (EPOS4)",
        node=acts.foreign_pdo_unmappable,
    ),
    Quirk(
        "mapping_swapped",
        "starts with the mappings of its first two TPDOs exchanged, other than its EDS says",
        _MAPPING,
        "ros_canopen#425; canopen#554; maxon_epos4_ros1#1",
        node=acts.mapping_swapped,
    ),
    Quirk(
        "tpdo_by_event", "refuses transmission types of TPDOs below 254", _RECORD, "unsourced", node=acts.tpdo_by_event
    ),
    Quirk(
        "inhibit_time",
        "sends TPDOs not more often than this",
        _RECORD,
        "yarp-devices#232 (iPOS: 30 ms)",
        node=acts.inhibit_at_least,
        strength=_s(0.03, 6.0),
    ),
    Quirk("rpdo_late", "takes RPDOs late", _CYCLIC, "unsourced", node=acts.rpdos_late, strength=_s(0.003, 1.0)),
    Quirk(
        "length_error_8220",
        "reports an RPDO of another length with EMCY 0x8220",
        "CiA 301, 7.2.7 (EMCY codes)",
        "ros2_canopen#36 (Ingenia)",
        node=acts.length_error_8220,
    ),
    # NMT, error control, EMCY
    Quirk(
        "boot_delay",
        "needs a time from a reset to its boot-up message",
        _NMT,
        "unsourced",
        node=acts.boots_after,
        strength=_s(5.0),
    ),
    Quirk("boot_unsaid", "sends no boot-up message", _NMT, "unsourced", node=acts.boot_unsaid),
    Quirk(
        "already_operational",
        "is OPERATIONAL without a command",
        _NMT,
        "unsourced",
        node=acts.operational_by_itself,
    ),
    Quirk(
        "start_without_errors",
        "obeys NMT start only while 0x1001 is 0",
        _NMT,
        "CANopenNode#297, #26",
        node=acts.start_without_errors,
    ),
    Quirk(
        "start_after_boot",
        "obeys NMT start a time after its boot-up message",
        _NMT,
        "unsourced",
        node=acts.start_after_boot,
        strength=_s(3.0),
    ),
    Quirk(
        "heartbeat_absent",
        "has no heartbeat: neither 0x1016 nor 0x1017",
        "CiA 301, 7.2.8.2 (error control)",
        "ros_canopen#106, #367",
        node=acts.heartbeat_absent,
        group="heartbeat",
    ),
    Quirk(
        "heartbeat_at_start",
        "sends heartbeats with this period from its boot-up on",
        "CiA 301, object 0x1017",
        "unsourced",
        node=acts.heartbeat_default,
        strength=_s(1.0),
        group="heartbeat",
    ),
    Quirk(
        "heartbeats_at_boot",
        "sends four heartbeats within 4 ms of its boot-up message",
        "CiA 301, 7.2.8.2 (error control)",
        "CANopenNode#30",
        node=acts.heartbeats_at_boot,
    ),
    Quirk(
        "consumer_rounded",
        "rounds the times of 0x1016 up to a multiple",
        _CONSUMER,
        "unsourced",
        node=acts.consumer_rounded,
        strength=_s(0.1, 10.0),
        group="0x1016",
    ),
    Quirk(
        "consumer_refused",
        "refuses to write 0x1016",
        _CONSUMER,
        "unsourced",
        node=acts.consumer_refused,
        group="0x1016",
    ),
    Quirk(
        "sync_counter_absent",
        "has no 0x1019",
        "CiA 301, object 0x1019",
        "ros_canopen#349: canopen_master/CHANGELOG",
        node=acts.sync_counter_absent,
    ),
    Quirk(
        "clock_drift",
        "has a clock that is fast by this, or slow",
        "",
        "unsourced",
        node=acts.drifts_by,
        strength=Strength("ppm", 100.0, -1000.0, 1000.0),
    ),
    Quirk(
        "emcy_own_register",
        "sends an error register of its manufacturer in bytes 3 and 4 of an EMCY",
        _EMCY,
        "Faulhaber, MC 5010 manual, p. 25",
        node=acts.emcy_own_register,
        group="EMCY",
    ),
    Quirk(
        "emcy_own_data",
        "sends data of its manufacturer in bytes 3 to 7 of every EMCY",
        _EMCY,
        "ros2_canopen#298 (Leadshine iSV2)",
        node=acts.emcy_own_data,
        group="EMCY",
    ),
    Quirk(
        "emcy_at_boot",
        "sends EMCY 0x1000 and its end after its boot-up message",
        _EMCY,
        "c-open#51",
        node=acts.error_at_boot,
    ),
    Quirk(
        "emcy_zeros_at_boot",
        "sends an EMCY of zeros after its boot-up message",
        _EMCY,
        "unsourced",
        node=acts.zeros_at_boot,
    ),
)
QUIRKS: Final[dict[str, Quirk]] = {quirk.name: quirk for quirk in _ROWS}
"""All quirks by name."""
