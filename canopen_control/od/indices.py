"""Indices of the objects that CiA 301 and CiA 302 define for all devices; those of drives are in `cia402.objects`."""

from __future__ import annotations

from typing import Final

FIRST_OBJECT: Final = 0x1000  # smaller indices are data types, mapped as dummy entries (CiA 301, 7.4.1.2)

# CiA 301, 7.5.2
DEVICE_TYPE: Final = 0x1000
COB_ID_SYNC: Final = 0x1005
CYCLE_PERIOD: Final = 0x1006  # communication cycle period: of SYNC, in us
GUARD_TIME: Final = 0x100C
LIFE_FACTOR: Final = 0x100D
STORE: Final = 0x1010
RESTORE: Final = 0x1011
COB_ID_TIME: Final = 0x1012
COB_ID_EMCY: Final = 0x1014
HEARTBEAT_CONSUMER: Final = 0x1016
HEARTBEAT_PRODUCER: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_OVERFLOW: Final = 0x1019  # synchronous counter overflow value
ERROR_BEHAVIOUR: Final = 0x1029
RPDO: Final = 0x1400  # communication parameters of the first of 512 RPDOs
RPDO_MAPPING: Final = 0x1600
TPDO: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00

# CiA 302-2: NMT start-up; CiA 302-3: configuration manager and program download
CONCISE_DCF: Final = 0x1F22
PROGRAM_DATA: Final = 0x1F50
PROGRAM_CONTROL: Final = 0x1F51
SOFTWARE_DATE: Final = 0x1F52
PROGRAM_ID: Final = 0x1F56
FLASH_STATUS: Final = 0x1F57
NMT_STARTUP: Final = 0x1F80
SLAVE_ASSIGNMENT: Final = 0x1F81
REQUEST_NMT: Final = 0x1F82
