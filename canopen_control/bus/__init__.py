"""CAN channels of all kinds, with a common port interface.

Operating system errors become `BusError` here and nowhere else.
"""
