"""Calibration of a differential drive base: UMBmark squares, the wheel values they give, and a copy of the YAML."""
