"""Sockets of this package: typed messages (`messages`), servers and clients."""
