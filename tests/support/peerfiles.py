"""Folders as ros2_canopen's own tests have them: a bus.yml of `tests/data/ros2_canopen` and the EDS files it names."""

from __future__ import annotations

import shutil
from pathlib import Path

from support.iomodule import eds_of

from canopen_control.data_files import data_path

_DATA = Path(__file__).parents[1] / "data" / "ros2_canopen"
NAMES = sorted(path.stem for path in _DATA.glob("*.yml"))
ROBOTS = sorted(path.parent.name for path in _DATA.glob("*/bus.yml"))  # robots with controllers
_U8, _U16, _U32, _I8, _I16, _I32 = 5, 6, 7, 2, 3, 4
_OBJECTS = {
    "1000": ("Device type", _U32, "ro", "0", 0),
    "1001": ("Error register", _U8, "ro", "0", 0),
    "1017": ("Producer heartbeat time", _U16, "rw", "0", 0),
    "4000": ("Unsigned 32 received by RPDO", _U32, "rww", "0", 1),
    "4001": ("Unsigned 32 sent by TPDO", _U32, "rwr", "0", 1),
}
_NUMBERS = [(kind, "rw", "0") for kind in (_U8, _I8, _I16, _I32, _U8, _U16, _U32)]
_RECORDS = {
    "1016": ("Consumer heartbeat time", [(_U8, "ro", "1"), (_U32, "rw", "0")]),
    "1018": ("Identity", [(_U8, "ro", "4"), *[(_U32, "ro", value) for value in ("0x360", "0", "1", "0")]]),
    "1400": ("RPDO 1", [(_U8, "ro", "2"), (_U32, "rw", "$NODEID+0x200"), (_U8, "rw", "255")]),
    "1600": ("RPDO 1 mapping", [(_U8, "rw", "1"), (_U32, "rw", "0x40000020")]),
    "1800": ("TPDO 1", [(_U8, "ro", "2"), (_U32, "rw", "$NODEID+0x180"), (_U8, "rw", "255")]),
    "1A00": ("TPDO 1 mapping", [(_U8, "rw", "1"), (_U32, "rw", "0x40010020")]),
    "4004": ("Numbers of each type", [(_U8, "ro", "7"), *_NUMBERS]),
}


def write_peer_files(folder, name):
    """Write the files of one configuration below `folder`, and return where; its bus.yml is not edited."""
    config, drive = folder / name, "generic_cia402.eds" if name in ROBOTS else "TMCM-1270.eds"
    if name in ROBOTS:
        shutil.copytree(_DATA / name, config)
    else:
        config.mkdir()
        shutil.copy(_DATA / f"{name}.yml", config / "bus.yml")
    (config / "simple.eds").write_text(eds_of("simple.eds", _OBJECTS, _RECORDS))
    text = data_path("eds", drive).read_text()
    # device type expected by their tests: both servo drive and stepper (CiA 402-2)
    (config / "cia402_slave.eds").write_text(text.replace("DefaultValue=0x00020192", "DefaultValue=0x60192"))
    return config
