"""Operating system services: event loop, timers, local sockets, lines of JSON, child processes, files."""
