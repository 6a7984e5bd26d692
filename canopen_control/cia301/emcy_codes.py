"""The codes of the emergency object in words: error codes and the bits of the error register.

A code that is missing takes the text of its class: the first of its 16, its 256, its 4096 that has one. Sources: CiA
301, tables 26 and 43; CiA 402-2 for the drive's codes. Codes of class FFxx are the manufacturer's.
"""

from __future__ import annotations

import enum

__all__ = ["ERROR_TEXTS", "ErrorRegister", "error_text", "register_text"]


class ErrorRegister(enum.IntFlag):
    """0x1001 (table 43): GENERIC is set whenever another bit is."""

    NONE = 0
    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20
    MANUFACTURER = 0x80


ERROR_TEXTS: dict[int, str] = {
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current, device input side",
    0x2110: "short circuit or earth leakage, input side",
    0x2120: "earth leakage, input side",
    0x2130: "short circuit, input side",
    0x2200: "current inside the device",
    0x2213: "over-current in ramp function",
    0x2214: "over-current in the sequence",
    0x2220: "continuous over-current inside the device",
    0x2230: "short circuit or earth leakage inside the device",
    0x2240: "earth leakage inside the device",
    0x2250: "short circuit inside the device",
    0x2300: "current, device output side",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage, motor side",
    0x2330: "earth leakage, motor side",
    0x2340: "short circuit, motor side",
    0x2350: "load level fault (I2t, thermal)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3140: "mains frequency",
    0x3200: "voltage inside the device",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3230: "load error",
    0x3300: "output voltage",
    0x3310: "output over-voltage",
    0x3320: "armature circuit",
    0x3330: "field circuit",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4110: "ambient temperature too high",
    0x4120: "ambient temperature too low",
    0x4130: "supply air temperature",
    0x4140: "air outlet temperature",
    0x4200: "device temperature",
    0x4210: "device temperature too high",
    0x4220: "device temperature too low",
    0x4300: "drive temperature",
    0x4310: "drive temperature too high",
    0x4320: "drive temperature too low",
    0x4400: "supply temperature",
    0x4410: "supply temperature too high",
    0x4420: "supply temperature too low",
    0x5000: "device hardware",
    0x5100: "supply",
    0x5110: "low-voltage supply",
    0x5120: "supply of the intermediate circuit",
    0x5200: "control hardware",
    0x5210: "measurement circuit",
    0x5220: "computing circuit",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5410: "output stages",
    0x5420: "chopper",
    0x5430: "input stages",
    0x5440: "contacts",
    0x5441: "contact 1: shutdown or enable input",
    0x5450: "fuses",
    0x5500: "hardware memory",
    0x5510: "working memory",
    0x5520: "program memory",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6010: "software reset (watchdog)",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x6310: "loss of parameters",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7111: "brake chopper failure",
    0x7112: "brake chopper over-current",
    0x7113: "brake chopper protective circuit",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error or commutation malfunction",
    0x7123: "motor tilted",
    0x7200: "measurement circuit module",
    0x7300: "sensor",
    0x7301: "tacho fault",
    0x7302: "tacho wrong polarity",
    0x7303: "resolver 1 fault",
    0x7304: "resolver 2 fault",
    0x7305: "incremental sensor 1 fault",
    0x7306: "incremental sensor 2 fault",
    0x7307: "incremental sensor 3 fault",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7400: "computation circuit module",
    0x7500: "communication module",
    0x7510: "serial interface 1",
    0x7520: "serial interface 2",
    0x7600: "data storage module",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun (objects lost)",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN-ID collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed: too short",
    0x8220: "PDO too long",
    0x8230: "DAM MPDO not processed: destination not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO timeout",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8312: "difficult start-up",
    0x8313: "standstill torque",
    0x8321: "insufficient torque",
    0x8331: "torque fault",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8600: "positioning",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation control",
    0x8800: "winding control",
    0x8900: "process data monitoring",
    0x8A00: "control monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
    0xF001: "deceleration",
    0xF002: "sub-synchronous run",
    0xF003: "stroke operation",
    0xF004: "control",
    0xFF00: "device specific",
}

REGISTER_TEXTS: dict[ErrorRegister, str] = {
    ErrorRegister.GENERIC: "generic",
    ErrorRegister.CURRENT: "current",
    ErrorRegister.VOLTAGE: "voltage",
    ErrorRegister.TEMPERATURE: "temperature",
    ErrorRegister.COMMUNICATION: "communication",
    ErrorRegister.DEVICE_PROFILE: "device profile",
    ErrorRegister.MANUFACTURER: "manufacturer",
}


def error_text(code: int) -> str:
    """Return the meaning of an error code, or of the closest class that has one."""
    masks = (0xFFFF, 0xFFF0, 0xFF00, 0xF000) if code >> 12 else (0xFFFF, 0xFF00)
    for mask in masks:
        if (text := ERROR_TEXTS.get(code & mask)) is not None:
            return text
    return f"unknown error code 0x{code:04X}"


def register_text(register: int) -> str:
    """Return the names of the bits of an error register, comma separated; empty for 0."""
    return ", ".join(text for bit, text in REGISTER_TEXTS.items() if register & bit)
