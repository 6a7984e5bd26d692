"""UMBmark calibration of a differential drive base: squares, wheel factors, and a corrected copy of the YAML file."""
