"""Decoding of bus traffic, recordings, and reports and exports from recorded frames."""
