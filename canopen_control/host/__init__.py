"""What the operating system gives: one event loop, precise timers, local sockets, lines of JSON, child processes."""
