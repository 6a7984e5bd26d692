"""Conversion of our data for other CANopen software."""
