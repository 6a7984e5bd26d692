"""An I/O module (CiA 401) beside robby's drives: two digital and two analogue outputs in its RPDOs."""

from __future__ import annotations

import yaml
from support.robots import copy_robby

IO = 5
_OBJECTS = {
    "1000": ("Device type", 7, "ro", "0x00030191", 0),
    "1001": ("Error register", 5, "ro", "0", 0),
    "1017": ("Producer heartbeat time", 6, "rw", "0", 0),
}
_RECORDS = {
    "1018": ("Identity", [(5, "ro", "1"), (7, "ro", "0x99")]),
    "1400": ("RPDO 1", [(5, "ro", "2"), (7, "rw", "$NODEID+0x200"), (5, "rw", "255")]),
    "1401": ("RPDO 2", [(5, "ro", "2"), (7, "rw", "$NODEID+0x300"), (5, "rw", "0")]),
    "1600": ("RPDO 1 mapping", [(5, "rw", "2"), (7, "rw", "0x62000108"), (7, "rw", "0x62000208")]),
    "1601": ("RPDO 2 mapping", [(5, "rw", "2"), (7, "rw", "0x64110110"), (7, "rw", "0x64110210")]),
    "6200": ("Digital outputs", [(5, "ro", "2"), (5, "rww", "0x0F"), (5, "rww", "0xA0")]),
    "6411": ("Analogue outputs", [(5, "ro", "2"), (3, "rww", "100"), (3, "rww", "-200")]),
}


def _outputs(index):
    return [{"index": index, "sub_index": subindex} for subindex in (1, 2)]


def io_eds():
    """Return its EDS."""
    return eds_of("io.eds", _OBJECTS, _RECORDS)


def eds_of(file, objects, records):
    """Return an EDS of single objects (title, type, access, value, mapping) and records (title, their entries)."""
    optional = [name for name in (*objects, *records) if name not in ("1000", "1001", "1018")]
    rpdos, tpdos = (sum(name.startswith(first) for name in records) for first in ("14", "18"))
    text = f"[FileInfo]\nFileName={file}\n[DeviceInfo]\nNrOfRXPDO={rpdos}\nNrOfTXPDO={tpdos}\nGranularity=8\n"
    text += "[MandatoryObjects]\nSupportedObjects=3\n1=0x1000\n2=0x1001\n3=0x1018\n"
    text += f"[OptionalObjects]\nSupportedObjects={len(optional)}\n"
    text += "".join(f"{place}=0x{name}\n" for place, name in enumerate(optional, 1))
    for name, (title, kind, access, value, mapped) in objects.items():
        text += f"[{name}]\nParameterName={title}\nObjectType=7\nDataType={kind}\nAccessType={access}\n"
        text += f"DefaultValue={value}\nPDOMapping={mapped}\n"
    for name, (title, subs) in records.items():
        text += f"[{name}]\nParameterName={title}\nObjectType=9\nSubNumber={len(subs)}\n"
        for number, (kind, access, value) in enumerate(subs):
            text += f"[{name}sub{number}]\nParameterName={title} {number}\nObjectType=7\nDataType={kind}\n"
            text += f"AccessType={access}\nDefaultValue={value}\nPDOMapping={int(access == 'rww')}\n"
    return text


EDS_TEXT = io_eds()


def with_io_module(folder, transmission=255):
    """Copy robby with an I/O module as node 5 to `folder`; `transmission` is the type of its first RPDO."""
    config = copy_robby(folder)
    (config / "io.eds").write_text(EDS_TEXT)
    path = config / "bus.yml"
    bus = yaml.safe_load(path.read_text())
    defaults = bus.pop("defaults")
    bus["nodes"] = {name: {**defaults, **node} for name, node in bus["nodes"].items()}
    rpdo = {"enabled": True, "cob_id": "auto"}
    bus["nodes"]["io_module"] = {
        "dcf": "io.eds",
        "node_id": IO,
        "heartbeat_producer": 100,
        "rpdo": {
            1: {**rpdo, "transmission": transmission, "mapping": _outputs(0x6200)},
            2: {**rpdo, "transmission": 0, "mapping": _outputs(0x6411)},
        },
    }
    path.write_text(yaml.safe_dump(bus))
    return config
