"""Runtime of a robot: CAN buses, control loop and client socket, all in a single thread."""
