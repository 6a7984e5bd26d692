"""The wire: ports to CAN channels of every kind, and the only place where operating system errors become ours."""
