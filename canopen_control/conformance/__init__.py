"""Conformance of CANopen devices: checks of CiA 301, 305, 306 and 402 at one node, their runner and their reports."""
