"""Operating system services: event loop, timers, local sockets, JSON lines, child processes and files."""
