"""CAN channels of all kinds, with one common port interface.

Operating system errors become `BusError` here and nowhere else.
"""
