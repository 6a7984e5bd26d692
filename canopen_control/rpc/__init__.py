"""Sockets of this package: typed messages (`messages`), servers and clients that exchange lines of JSON."""
