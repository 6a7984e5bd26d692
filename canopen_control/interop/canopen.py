"""Conversion of an object dictionary for scripts that use the `canopen` package.

Only this module imports `canopen`. Types, access, defaults, limits and mappability are preserved. Two limits of
`canopen` apply: a name that is used twice refers to the object that was added last, so that indices are safer; and
TIME_OF_DAY and TIME_DIFFERENCE have no codec, so that their values are bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import canopen
from canopen import objectdictionary as theirs

from canopen_control.od.codec import encode
from canopen_control.od.model import SCALAR_CODES, DataType, ObjectCode

if TYPE_CHECKING:
    from canopen_control.od.model import DeviceInfo, Entry, ObjectDictionary, Value


_TIMES = (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)
_DEVICE_FIELDS = {  # attribute of `canopen`: attribute of DeviceInfo
    "vendor_name": "vendor_name",
    "vendor_number": "vendor_number",
    "product_name": "product_name",
    "product_number": "product_number",
    "revision_number": "revision_number",
    "order_code": "order_code",
    "simple_boot_up_master": "simple_boot_up_master",
    "simple_boot_up_slave": "simple_boot_up_slave",
    "granularity": "granularity",
    "dynamic_channels_supported": "dynamic_channels",
    "group_messaging": "group_messaging",
    "nr_of_RXPDO": "rpdo_count",
    "nr_of_TXPDO": "tpdo_count",
    "LSS_supported": "lss_supported",
}


def to_canopen(od: ObjectDictionary) -> canopen.ObjectDictionary:
    """Return a copy of an object dictionary for ``canopen.RemoteNode`` and ``canopen.LocalNode``."""
    result = canopen.ObjectDictionary()  # type: ignore[no-untyped-call] # its __init__ has no annotations
    result.node_id, result.bitrate = od.node_id, od.bitrate
    result.comments = "\n".join(od.comments)
    _give_device(od.device, result.device_information)
    subindices: dict[int, list[Entry]] = {index: [] for index in od.objects}
    for entry in od:
        subindices.setdefault(entry.index, []).append(entry)
    for index in sorted(subindices):
        info, entries = od.objects[index], sorted(subindices[index], key=lambda entry: entry.subindex)
        if info.code in SCALAR_CODES and len(entries) == 1:
            result.add_object(_variable(entries[0]))
            continue
        group = (theirs.ODArray if info.code is ObjectCode.ARRAY else theirs.ODRecord)(info.name, index)
        for entry in entries:
            group.add_member(_variable(entry))
        result.add_object(group)
    return result


def _give_device(device: DeviceInfo, target: theirs.DeviceInformation) -> None:
    for name, ours in _DEVICE_FIELDS.items():
        setattr(target, name, getattr(device, ours))
    target.allowed_baudrates = set(device.bit_rates)


def _variable(entry: Entry) -> theirs.ODVariable:
    variable: Any = theirs.ODVariable(entry.name, entry.index, entry.subindex)
    variable.data_type = int(entry.data_type)
    variable.access_type = entry.access
    variable.pdo_mappable = entry.pdo_mappable
    variable.default = _value(entry, entry.default)
    variable.value = _value(entry, entry.parameter_value)
    variable.min, variable.max = entry.low, entry.high
    variable.relative = entry.relative
    result: theirs.ODVariable = variable
    return result


def _value(entry: Entry, value: Value | None) -> Value | None:
    return encode(value, entry.data_type) if value is not None and entry.data_type in _TIMES else value
