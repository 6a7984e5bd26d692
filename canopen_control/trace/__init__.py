"""Decoder of bus traffic, and recordings, reports and exports made from recorded frames."""
