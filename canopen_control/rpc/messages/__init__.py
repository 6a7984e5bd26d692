"""Messages of all sockets as frozen structures, without I/O, for every subpackage."""
