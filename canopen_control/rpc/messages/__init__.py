"""Messages of all sockets as frozen structures, without I/O; usable in every subpackage."""
