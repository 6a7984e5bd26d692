"""Conversion of object dictionaries for other CANopen libraries."""
