"""The messages of every socket, as frozen structures: no I/O, free to be imported by every subpackage."""
