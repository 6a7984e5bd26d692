"""CAN channels of every kind behind one port interface.

Operating system errors become `BusError` here and nowhere else.
"""
