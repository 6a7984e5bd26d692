"""Conformance of CANopen devices: checks of one node by CiA 301, 302, 305, 306 and 402, their runner and reports."""
