"""Messages of all sockets as frozen structures, without I/O; importable from every subpackage."""
