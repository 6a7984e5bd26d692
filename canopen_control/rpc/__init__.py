"""Sockets of this package: typed messages (`messages`), and servers and clients that exchange lines of JSON."""
